"""Has the rig a time-out of its own on theta? Judged by how it oscillates while nobody commands.

Pure: arrays in, findings out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_commission.fitness.fitness import NOTE, OK, Finding
from koop_commission.fitness.settings import DEFAULTS
from koop_core.config.knobs import format_knobs
from koop_tune.rig.rig_file import RigFile

NAME = "time-out"


class Telling(NamedTuple):
    """The difference between blocks at theta_safe and at another theta.

    Attributes
    ----------
    weights : ndarray, shape (f,)
        Of each feature.
    far, safe : float
        Their weighted sum at the other theta and at theta_safe.
    clear : float
        The difference of these in standard deviations.
    """

    weights: NDArray[np.float64]
    far: float
    safe: float
    clear: float

    def share(self, features: NDArray[np.float64]) -> float:
        """Return how far a block is on the way from the other theta (0) to theta_safe (1)."""
        return float((features @ self.weights - self.far) / (self.safe - self.far))


def tell_apart(far: NDArray[np.float64], safe: NDArray[np.float64]) -> Telling:
    """Weigh the features of blocks, shape (blocks, f), by Fisher's rule, as if independent."""
    spread = np.concatenate([far, safe]).std(axis=0) + 1e-12
    within = 0.5 * (far.var(axis=0, ddof=1) + safe.var(axis=0, ddof=1)) / spread**2
    change = (safe.mean(axis=0) - far.mean(axis=0)) / spread
    weights = change / (within + DEFAULTS.lucky) / spread
    at_far, at_safe = far @ weights, safe @ weights
    noise = np.sqrt(0.5 * (at_far.var(ddof=1) + at_safe.var(ddof=1)))
    mean_far, mean_safe = float(at_far.mean()), float(at_safe.mean())
    return Telling(weights, mean_far, mean_safe, abs(mean_safe - mean_far) / max(noise, 1e-12))


def is_back(shares: Sequence[float]) -> bool:
    """Return whether the last two blocks are at theta_safe."""
    return len(shares) > 1 and all(abs(share - 1.0) < 0.5 for share in shares[-2:])


def judge_time_out(
    rig: RigFile, far: Sequence[float], shares: Sequence[float], ends: Sequence[float]
) -> Finding:
    """Judge the blocks that followed the last command.

    Parameters
    ----------
    rig : RigFile
        The rig.
    far : sequence of float
        Theta that was commanded last.
    shares, ends : sequence of float
        Where each block is between that theta (0) and theta_safe (1), and its end after the last
        command [s].
    """
    if is_back(shares):
        text = (
            f"within {ends[-2]:.3g} s without a command the rig oscillates as at theta_safe: it "
            "has a time-out of its own"
        )
        return Finding(OK, NAME, text)
    last = f"{ends[-1]:.3g} s after the last command the rig oscillates" if ends else "nothing seen"
    stays = "if this machine dies, theta stays"
    at, safe = format_knobs(far, ".4g"), rig.spell("theta_safe", ".4g")
    if shares and all(abs(share) < 0.5 for share in shares[-2:]):
        text = f"{last} as at theta = {at}: no time-out, or a longer one; {stays}"
    else:
        text = (
            f"{last} neither as at theta = {at} nor as at theta_safe = {safe}: "
            f"is its time-out to another theta? Without one, {stays}"
        )
    return Finding(NOTE, NAME, text)


def describe_doubt(telling: Telling) -> str:
    """Return why the test cannot tell, empty if it can."""
    if telling.clear >= DEFAULTS.apart:
        return ""
    return (
        "of the rig was not tested: the oscillation at theta_safe differs by "
        f"{telling.clear:.2g} standard deviations only from the one beside it, "
        f"{DEFAULTS.apart:g} are needed"
    )
