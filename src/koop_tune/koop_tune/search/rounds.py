"""Rounds of a verification: closed loops with their prediction, as ``verify.json`` holds them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from koop_core.whole_file import read_object
from koop_tune.search.agreement import Aim, Measured
from koop_tune.search.prediction import Prediction
from koop_tune.search.settings import CONVERGENCE, VERIFICATION, VerificationSettings

VERIFIED = "verify.json"


@dataclass(frozen=True)
class LoopRun:
    """One closed loop.

    Attributes
    ----------
    start : tuple of float
        Theta of each knob at which the loop was closed.
    measured : Measured
        The figures.
    bag : str
        Its recording, relative to the folder of the commissioning.
    seconds : float
        Time that the loop was closed [s].
    steps : tuple of int
        First and last step with the loop closed.
    """

    start: tuple[float, ...]
    measured: Measured
    bag: str = ""
    seconds: float = 0.0
    steps: tuple[int, int] = (0, 0)


@dataclass(frozen=True)
class Round:
    """One tuning with its closed loops.

    Attributes
    ----------
    number : int
        The first is 1.
    prediction : Prediction
        The tuning's.
    runs : tuple of LoopRun
        One from each start.
    agrees : bool or None
        Whether no run was worse than predicted; None until all were made.
    damped : bool
        Whether the rig was damped.
    summary : str
        The figures that were worse, or that none was.
    best : float
        y of the best amplitude of its map, the error on top.
    """

    number: int
    prediction: Prediction
    runs: tuple[LoopRun, ...] = ()
    agrees: bool | None = None
    damped: bool = False
    summary: str = ""
    best: float = math.inf

    @property
    def finished(self) -> bool:
        """Whether all runs were made."""
        return self.agrees is not None

    @property
    def worst_excess(self) -> float:
        """Amplitude over the best one, from the worse start."""
        return max(run.measured.excess for run in self.runs)


@dataclass(frozen=True)
class Verification:
    """Content of ``verify.json``.

    Attributes
    ----------
    rounds : tuple of Round
        Rounds, the first one first.
    damped : bool
        Whether the rig was damped with the controller that is kept.
    feature : str
        Amplitude that was measured.
    verdict : str
        Its lines, the answer first.
    """

    rounds: tuple[Round, ...] = ()
    damped: bool = False
    feature: str = ""
    verdict: str = ""

    @property
    def finished(self) -> tuple[Round, ...]:
        """Rounds of which all runs were made."""
        return tuple(item for item in self.rounds if item.finished)


def find_slowdown(rounds: Sequence[Round], settings: VerificationSettings = VERIFICATION) -> float:
    """Return the factor by which a rig is slower than its recordings show.

    The times that the loops of each round that disagreed took to converge over the longest time
    predicted, multiplied.
    """
    slowdown = 1.0
    for item in rounds:
        longest = item.prediction.converges.high
        if item.agrees is not False or math.isinf(longest):
            continue
        times = [run.measured.time_to_converge for run in item.runs]
        most = settings.most_slower
        ratios = [most if time is None else time / longest for time in times]
        slowdown *= min(max(1.0, *ratios), most)
    return slowdown


def find_longer(rounds: Sequence[Round]) -> float:
    """Return the factor by which the loops of the next round are closed longer.

    Each round that ended near the best from both ends and was not damped lengthens it: what kept it
    from being so was the error.
    """
    good = CONVERGENCE.good
    doubtful = [r for r in rounds if r.finished and not r.damped and r.worst_excess <= good]
    return VERIFICATION.longer ** len(doubtful)


def inform(aim: Aim, rounds: Sequence[Round]) -> Aim:
    """Return an aim that knows what earlier rounds did: no round knows less than the one before."""
    known = min([aim.known, *(item.best for item in rounds if item.finished)])
    return replace(aim, longer=find_longer(rounds), known=known)


def kept_index(rounds: Sequence[Round], sense: float) -> int:
    """Return the index of the finished round whose controller is kept.

    The last one's if it damped the rig, which ends the rounds; else that of the round with the
    best amplitude from its worse start: each measures the same, but its map may not know the best.
    ``sense`` is +1 if little is wanted, else -1.
    """
    if rounds[-1].damped:
        return len(rounds) - 1
    worst = [max(sense * run.measured.amplitude for run in item.runs) for item in rounds]
    return worst.index(min(worst))


def load_verification(folder: Path) -> Verification:
    """Return the content of verify.json; without rounds if there is none.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If it cannot be used.
    """
    return read_object(folder / VERIFIED, Verification) or Verification()
