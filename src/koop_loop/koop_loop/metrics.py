"""The paper's performance metrics of a closed loop (section 3.6, table 4)."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from koop_core.errors import InputError
from koop_loop.settings import METRICS

PAPER_DURATION = 2500.0  # [s] length of the paper's runs
LOGGING_START = 100.0  # [s] the paper logs from here on, to leave out the initial transient


@dataclass(frozen=True)
class Metrics:
    """Metrics of one run."""

    iae_theta: float
    """Integral of |theta - theta*| [s]."""
    ise_theta: float
    """Integral of (theta - theta*)^2 [s]."""
    t_theta: float | None
    """First time with |theta - theta*| below the tolerance [s]; None if never."""
    e_r_ss: float | None
    """|mean r over the last 30 % - r*| / (max r - min r) [-], r* from ``koop_loop.static_map``;
    None without an r*, a range or a cost in those 30 %."""
    tail_error: float
    """Mean |theta - theta*| over the last 30 %."""

    @property
    def converged(self) -> bool:
        """True if theta stayed near theta* on average over the last 30 %."""
        return self.tail_error <= METRICS.converged

    def as_dict(self) -> dict[str, float | bool | None]:
        """Return the metrics in JSON terms."""
        return {**asdict(self), "converged": self.converged}


PAPER = {  # table 4
    "raw": Metrics(5125.73, 14720.91, 1977.0, 0.08816, float("nan")),
    "lifted": Metrics(1445.30, 3166.17, 258.0, 0.02486, float("nan")),
}


def evaluate(
    t: NDArray[np.float64],
    theta: NDArray[np.float64],
    r: NDArray[np.float64],
    theta_star: float | tuple[float, ...],
    r_star: float | None = None,
) -> Metrics:
    """Compute the metrics of a run from 100 s on; a shorter one counts from its begin.

    Time [s] is uniformly spaced; it and the cost have shape (M,), theta has (M,) or, of n knobs,
    (M, n): the error is then the distance from theta_star. r_star is the cost at theta_star, see
    :func:`koop_loop.static_map.settled`.

    Raises
    ------
    koop_core.errors.InputError
        If the arrays differ in length or hold fewer than two samples.
    """
    if not t.size == len(theta) == r.size or t.size < 2:
        raise InputError("t, theta and r must have the same length of at least 2")
    start = LOGGING_START if t[-1] > LOGGING_START else float(t[0])
    logged = slice(int(np.searchsorted(t, start)), None)
    error = np.linalg.norm(theta.reshape(t.size, -1)[logged] - theta_star, axis=1)
    dt = float(t[-1] - t[0]) / (t.size - 1)
    reached = np.flatnonzero(error < METRICS.tolerance)
    tail = slice(-max(1, round(METRICS.tail * error.size)), None)
    logged_r = r[logged][np.isfinite(r[logged])]
    span = float(np.ptp(logged_r)) if logged_r.size else 0.0
    e_r_ss = None
    last_r = np.where(np.isfinite(r), r, np.nan)[logged][tail]
    if r_star is not None and span > 0.0 and not np.isnan(last_r).all():
        e_r_ss = abs(float(np.nanmean(last_r)) - r_star) / span
    return Metrics(
        float(error.sum() * dt),
        float((error**2).sum() * dt),
        float(t[logged][reached[0]]) if reached.size else None,
        e_r_ss,
        float(error[tail].mean()),
    )
