"""Content of ``tune.json``: the static maps, and the controller with its prediction."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from koop_core.config.parameter import ConfigError
from koop_core.whole_file import read_object
from koop_tune.excitation.amplitude import Amplitude, Mode
from koop_tune.excitation.static_map import Interval
from koop_tune.folder import FIGURES
from koop_tune.rig.rig_file import RigFile
from koop_tune.search.agreement import Aim, KnobAim
from koop_tune.search.prediction import Prediction
from koop_tune.search.run import Constants
from koop_tune.search.settings import CONVERGENCE, VERIFICATION


class Points(NamedTuple):
    """Levels over rising theta, and the standard errors of their logarithms."""

    theta: list[float]
    level: list[float]
    error: list[float]


class Curves(NamedTuple):
    """A band over time: 5 %, median and 95 % of the runs."""

    low: list[float]
    middle: list[float]
    high: list[float]


class LoopPath(NamedTuple):
    """Predicted runs from one end of theta's range, over time [s]."""

    start: float
    time: list[float]
    theta: Curves
    amplitude: Curves


class CostResult(NamedTuple):
    """A cost: evidence and score, if it was searched; the best theta and r of its clearest map."""

    name: str
    evidence: float
    score: float | None
    problem: str
    theta_best: float | None
    r: Points | None


class ParameterResult(NamedTuple):
    """A parameter that is not a default, and the reason for its value."""

    name: str
    value: Any
    unit: str
    reason: str
    node: str


@dataclass(frozen=True)
class AmplitudeMap:
    """The static map of the amplitude.

    Attributes
    ----------
    feature : str
        The amplitude in words.
    amplitude : Amplitude
        What is summed.
    modes : list of Mode
        Its parts, with their shares over theta.
    theta_best : float
        The best theta.
    best, error : float
        Logarithm of the amplitude there, and by how much a better one may be.
    valley : Interval
        Thetas between which the map is within 1.5 times the best.
    motion : float
        How far the optimum moved meanwhile, in ranges.
    period, growth : float
        The oscillation's period, and the longest time that it was seen to grow [s].
    holds, curve : Points
        Amplitude at the holds, and the map that fits.
    knob : int
        Number of the knob over which it is; of several, a section through the best of all.
    """

    feature: str
    amplitude: Amplitude
    modes: list[Mode]
    theta_best: float
    best: float
    error: float
    valley: Interval
    motion: float
    period: float
    growth: float
    holds: Points
    curve: Points
    knob: int = 0

    @property
    def shares(self) -> list[str]:
        """Its largest parts with their shares, in words; empty if it has one part only."""
        return [mode.describe() for mode in self.modes[:6]] * (len(self.modes) > 1)

    @property
    def moved(self) -> str:
        """What a motion of the optimum means for the map, in words; empty without one."""
        if not self.motion:
            return ""
        return (
            f"it looks as if the optimum moved by {100.0 * self.motion:.2g} % of the range while "
            "this was recorded: thetas are those at which the rig would now be as it was (an "
            "amplitude that wanders for longer than theta was held looks alike, and hysteresis: if "
            "it depends on where theta came from, narrow the limits and record again)"
        )


@dataclass(frozen=True)
class ControllerResult:
    """The controller that was chosen.

    Attributes
    ----------
    cost, doubt : str
        Its cost; what is not sure about the optimum, in words, empty if it is.
    constants : Constants
        Result of the search.
    time : float
        The rig's own time [s].
    predicted : Prediction
        Figures of the loop.
    paths : list of LoopPath
        Runs from the lower and the upper end of theta's range.
    parameters : list of ParameterResult
        The parameter file, without defaults.
    """

    cost: str
    doubt: str
    constants: Constants
    time: float
    predicted: Prediction
    paths: list[LoopPath]
    parameters: list[ParameterResult]


@dataclass(frozen=True)
class TuneResult:
    """Result of a tuning.

    Attributes
    ----------
    verdict, why : str
        ``tuned``, or the kind of the refusal, and the reason; empty before a tuning.
    static_map : AmplitudeMap or None
        Of several knobs, of that which shows the optimum best; None if nothing reacts to theta.
    costs : list of CostResult
        Every candidate.
    controller : ControllerResult or None
        None if tuning was refused.
    others : list of AmplitudeMap
        Of the other knobs that have an effect.
    """

    verdict: str = ""
    why: str = ""
    static_map: AmplitudeMap | None = None
    costs: list[CostResult] = field(default_factory=list)
    controller: ControllerResult | None = None
    others: list[AmplitudeMap] = field(default_factory=list)

    @property
    def maps(self) -> dict[int, AmplitudeMap]:
        """The map over each knob that has an effect."""
        maps = [] if self.static_map is None else [self.static_map, *self.others]
        return {each.knob: each for each in sorted(maps, key=lambda each: each.knob)}

    @property
    def is_refused(self) -> bool:
        """Whether tuning found no optimum."""
        return bool(self.verdict) and self.controller is None

    def require_controller(self) -> tuple[AmplitudeMap, ControllerResult]:
        """Return the static map and the controller.

        Raises
        ------
        koop_core.config.parameter.ConfigError
            If there is none.
        """
        if self.is_refused:
            raise ConfigError(f"koop tune made no controller, {self.verdict}: {self.why}")
        if self.static_map is None or self.controller is None:
            raise ConfigError("no controller was tuned: run 'koop tune' first")
        return self.static_map, self.controller

    def make_aim(self, rig: RigFile) -> Aim:
        """Return the figures that a loop of the controller is compared with.

        The best is that of all sections. A knob without an effect may be anywhere.

        Raises
        ------
        koop_core.config.parameter.ConfigError
            If there is no controller.
        """
        fit, controller = self.require_controller()
        least = min(self.maps.values(), key=lambda each: rig.sense * each.best + each.error)
        best = rig.sense * least.best
        holds = [each.holds for each in self.maps.values()]
        y = rig.sense * np.log([level for each in holds for level in each.level])
        error = np.array([error for each in holds for error in each.error])
        knobs = [KnobAim(s, rest, (s.low, s.high))
                 for s, rest in zip(rig.scales, rig.each("theta_start"), strict=True)]  # fmt: skip
        for k, each in self.maps.items():
            knobs[k] = KnobAim(rig.scales[k], each.theta_best, each.valley)
        return Aim(
            fit.amplitude, fit.feature, tuple(knobs), rig.sense, least.best, least.error,
            rig.sense * (best + CONVERGENCE.bound(float(y.max()) - best)), controller.time,
            fit.growth, controller.predicted, tuple(fit.modes),
            known=float((y + VERIFICATION.seen * error).min()) + VERIFICATION.seen_besides,
        )  # fmt: skip


def read(folder: Path) -> TuneResult:
    """Return the result in a folder of ``koop tune``; an empty one if there is none.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If it cannot be read.
    """
    return read_object(folder / FIGURES, TuneResult) or TuneResult()
