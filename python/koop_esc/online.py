"""The loop's two online parts for a program of one's own: state to cost, and cost to control input.

They call what the nodes call, sample by sample, and give the same bits.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koop_core.errors import InputError
from koop_core.kernels import direct
from koop_core.stream.arrival import SHORTEST_DT, Arrival
from koopman_lifter import cost
from koopman_lifter.config import LifterConfig
from koopman_lifter.model import KoopmanModel
from relay_esc import directions
from relay_esc.config import EscConfig
from relay_esc.directions import DirectionState

if TYPE_CHECKING:
    from koop_esc.estimator import EDMD


class Cost:
    """Energy of a model's dominant modes in the measured state, filtered.

    Parameters
    ----------
    model : KoopmanModel or EDMD
        As :class:`~koop_esc.estimator.EDMD` identifies it, or that itself.
    settings
        Fields of :class:`koopman_lifter.config.LifterConfig`, such as ``omega_h``.
    """

    def __init__(self, model: KoopmanModel | EDMD, **settings: Any) -> None:
        model = getattr(model, "model_", model)
        if not isinstance(model, KoopmanModel):
            raise InputError(f"{model} is not a model, or not fitted yet: call its fit() first")
        config = LifterConfig(dt=model.dt, **settings)
        self._source, self._lifting = config.source, model.lifting()
        self._params, self._state = config.detector_params(), cost.initial()
        self._work, self._step = cost.workspace(self._lifting), -1
        self._x = np.zeros(model.delays.channels)
        self._answer = direct(cost.answer, *self._arguments(Arrival.RESTART))

    def _arguments(self, arrival: Arrival) -> tuple[Any, ...]:
        now = int(arrival), self._step, self._x, self._work
        return self._source, self._lifting, self._params, self._state, *now

    def step(self, x: ArrayLike) -> float:
        """Return the cost r after the next measured state, shape (n,); NaN where it is unusable.

        Raises ValueError if the state has another number of values than the model's.
        """
        state = np.ravel(x)
        if state.size != self._x.size:
            raise InputError(f"the state has {state.size} values, the model needs {self._x.size}")
        self._step += 1
        self._x[:] = state
        arrival = Arrival.NEXT if self._step else Arrival.RESTART
        r, _, _, self._state = self._answer(*self._arguments(arrival))
        return float(r)


class Seeker:
    """Relay extremum seeking for one control input, or for several.

    Parameters
    ----------
    dt : float
        Time between two costs [s], at least 1e-6.
    settings
        Fields of :class:`relay_esc.config.EscConfig`: ``law="adaptive"``, ``theta_min``,
        ``theta_max``, ``theta_initial``, ``step_size``, ``dwell`` and so on; a tuple of limits or
        initial values is one of several inputs.

    Examples
    --------
    >>> seeker = Seeker(0.01, law="adaptive", step_size=0.001, dwell=0.5, tau_f=0.1)
    >>> theta = seeker.theta
    >>> for _ in range(40000):
    ...     theta = seeker.step(1.0 + (theta + 3.0) ** 2)
    >>> bool(abs(theta + 3.0) < 0.1)
    True
    """

    def __init__(self, dt: float, **settings: Any) -> None:
        if not SHORTEST_DT <= dt < math.inf:
            raise InputError(f"dt = {dt:g}: must be a number of at least {SHORTEST_DT:g} s")
        config = EscConfig(**settings)
        if config.margin_slope:
            raise InputError("margin_slope: a Seeker is told no margin, so it keeps no such bound")
        self._params, self._knobs = config.knob(0).params(dt), config.knob_limits(dt)
        self._arrival, begin = int(Arrival.RESTART), config.initial_directions()
        self._answer = direct(directions.answer, *self._arguments(begin, 0.0))  # changes its arrays
        self._state = config.initial_directions()

    def _arguments(self, state: DirectionState, r: float) -> tuple[Any, ...]:
        return self._params, self._knobs, state, self._arrival, False, False, r, False

    @property
    def theta(self) -> float | NDArray[np.float64]:
        """Control input of now; of n > 1 inputs of shape (n,)."""
        theta = self._state.theta
        return float(theta[0]) if theta.size == 1 else theta.copy()

    def step(self, r: float) -> float | NDArray[np.float64]:
        """Return the control input after the next cost; it is held on one that is not finite."""
        self._state, _, _ = self._answer(*self._arguments(self._state, float(r)))
        self._arrival = int(Arrival.NEXT)
        return self.theta
