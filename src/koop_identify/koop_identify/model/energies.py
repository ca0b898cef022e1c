"""The instantaneous energy y_out of recorded states: by the lifter's kernel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from koop_core.borrowed import borrowed
from koop_core.kernels import njit
from koop_core.stream.arrival import Arrival
from koopman_lifter import cost
from koopman_lifter.cost import Lifting, Workspace
from koopman_lifter.model import KoopmanModel


def energies(
    model: KoopmanModel | None, x: NDArray[np.float64], begins: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return y_out of every state, NaN while the delay line fills.

    Parameters
    ----------
    model : KoopmanModel or None
        Model of the lifted cost; None for the raw one.
    x : ndarray, shape (channels, M)
        Measured channels, one dt apart.
    begins : ndarray of bool, shape (M,)
        Whether a state follows on none.

    Returns
    -------
    ndarray, shape (M,)
    """
    lifting = cost.no_lifting() if model is None else model.lifting()
    source = cost.RAW if model is None else cost.LIFTED
    y_out = np.empty(x.shape[1])
    rows = np.ascontiguousarray(x.T)
    _energies(source, lifting, cost.workspace(lifting), rows, begins, y_out)
    return y_out


@njit()
def _energies(
    source: int,
    lifting: Lifting,
    work: Workspace,
    x: NDArray[np.float64],
    begins: NDArray[np.bool_],
    y_out: NDArray[np.float64],
) -> None:
    lifting, work = cost.borrow(lifting, work)
    states = borrowed(x)
    for k in range(y_out.shape[0]):
        arrival = Arrival.JOIN if begins[k] else Arrival.NEXT
        y_out[k], _ = cost.energy(source, lifting, arrival, k, states[k], work)
