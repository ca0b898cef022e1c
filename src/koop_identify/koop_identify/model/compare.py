"""The costs that a recorded rig may have, each with its model and its energies on the recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.borrowed import borrowed
from koop_core.errors import InputError
from koop_core.kernels import njit
from koop_core.stream.arrival import Arrival
from koop_identify.model.from_bags import BagTraining, build_from, learn_contrast
from koop_identify.recording.loaded import Loaded, list_segments
from koop_identify.recording.samples import state_names
from koop_identify.settings import READING
from koopman_lifter import cost
from koopman_lifter.cost import Lifting, Workspace
from koopman_lifter.delays import Delays, spacing_for
from koopman_lifter.edmd import Gram
from koopman_lifter.model import KoopmanModel
from koopman_lifter.observables import Monomials

BLOCK = 65536  # samples in a row


class Cost(NamedTuple):
    """A candidate cost on a recording; where none can be made, without model and energies."""

    name: str
    training: BagTraining | None
    """With which its model is learned; None where the cost needs none."""
    model: KoopmanModel | None
    y_out: NDArray[np.float64] | None
    """Energies, shape (M,)."""
    problem: str = ""
    """Why it cannot be made."""


def costs(
    loaded: Loaded, training: BagTraining, period: float, most: int | None = None
) -> Iterator[Cost]:
    """Yield every candidate, learned from a recording.

    ``period`` is the oscillation's [s]; modes are learned from ``most`` samples, spread over
    the recording, or from all.
    """
    x, begins, dt = loaded.x, loaded.begins, training.reading.known_dt
    yield Cost("raw", None, None, energies(None, x, begins))
    n = x.shape[0]
    count = training.delays if training.delays > 1 else READING.delays
    spacing = spacing_for(period, count) if training.spacing is None else training.spacing
    for delays in (Delays(n), Delays.spaced(n, count, spacing, dt)):
        suffix, plain = "", replace(training, delays=1, spacing=None, contrast=False)
        if delays.count > 1:
            plain = replace(plain, delays=count, spacing=delays.every * dt)
            suffix = f", {count} samples {delays.every * dt:g} s apart"
        learn = partial(_learn, loaded, training, delays, most)
        lifted = _judge(f"lifted{suffix}", plain, loaded, learn)
        yield lifted
        name, with_period = f"contrast{suffix}", replace(plain, contrast=True, period=period)
        if lifted.model is None:
            yield lifted._replace(name=name, training=with_period)
        else:
            learn = partial(learn_contrast, lifted.model, loaded, period)
            yield _judge(name, with_period, loaded, learn)


def _judge(
    name: str, training: BagTraining, loaded: Loaded, learn: Callable[[], KoopmanModel]
) -> Cost:
    try:
        model = learn()
    except InputError as error:
        return Cost(name, training, None, None, str(error))
    return Cost(name, training, model, energies(model, loaded.x, loaded.begins))


def _learn(loaded: Loaded, training: BagTraining, delays: Delays, most: int | None) -> KoopmanModel:
    """Return the model of the recording, or of ``most`` of its samples."""
    gram = Gram.empty(Monomials(delays.n, training.degree_for(delays)))
    share = 1.0 if most is None else min(1.0, most / loaded.x.shape[1])
    length = BLOCK if share == 1.0 else READING.part
    for segment in list_segments(loaded.begins):
        for begin in range(segment.start, segment.stop, round(length / share)):
            # embedded, it is as many times as large as there are delays
            end = min(begin + length + delays.depth, segment.stop)
            gram.add_trajectory(delays.embed(loaded.x[:, begin:end]))
    names = state_names(training.reading.measured, delays.channels)
    return build_from(gram, training, names, {}, delays)


def energies(
    model: KoopmanModel | None, x: NDArray[np.float64], begins: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return y_out of states, shape (M,), by the lifter's kernel; NaN while the delay line fills.

    Without a model it is the raw cost's. ``x``, shape (channels, M), are measured one dt apart;
    ``begins``, shape (M,), says which states follow on none.
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
    lifting, work = borrowed(lifting), borrowed(work)
    states = borrowed(x)
    for k in range(y_out.shape[0]):
        arrival = Arrival.JOIN if begins[k] else Arrival.NEXT
        y_out[k], _ = cost.energy(source, lifting, arrival, k, states[k], work)
