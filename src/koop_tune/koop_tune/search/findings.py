"""Findings of an excitation: the static maps of the amplitude and of every cost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from koop_core.errors import InputError
from koop_identify.model.compare import Cost, costs
from koop_identify.model.from_bags import BagTraining
from koop_identify.model.windows import period_of
from koop_identify.recording.loaded import Loaded
from koop_tune.excitation.amplitude import Amplitude, Array, Mode, Windows, window_length
from koop_tune.excitation.design import DESIGN, Design
from koop_tune.excitation.safe_range import SafeRange
from koop_tune.excitation.static_map import MAP, StaticMap
from koop_tune.rig.rig_file import RigFile
from koop_tune.rig.scale import Scale
from koop_tune.rig_model.dwells import Dwells, find_dwells, find_holds
from koop_tune.rig_model.surrogate import high_pass
from koop_tune.search.limits import ThetaLimits, limit_theta
from koop_tune.search.settings import TUNING, TuningSettings


class NoOptimum(InputError):
    """There is no optimum to seek: ``kind`` is monotone, flat, drowned, undamped or unknown."""

    def __init__(
        self, kind: str, message: str, findings: Findings | None = None, knob: int = 0
    ) -> None:
        super().__init__(message)
        self.kind, self.findings, self.knob = kind, findings, knob


@dataclass(frozen=True)
class CostMaps:
    """A cost's static maps.

    Attributes
    ----------
    cost : Cost
        The cost.
    maps : dict of float to StaticMap
        Maps of the logarithm of y_hp, by omega_h [rad/s]; empty where the cost cannot be made.
    reference : StaticMap
        The amplitude's.
    near : float
        Distance within which an optimum is the amplitude's, in ranges.
    doubted : bool
        Whether the amplitude does not show beyond doubt that there is an optimum.
    """

    cost: Cost
    maps: dict[float, StaticMap]
    reference: StaticMap
    near: float
    doubted: bool = False

    @property
    def usable(self) -> dict[float, StaticMap]:
        """Maps that lead to the amplitude's optimum."""
        return {
            omega_h: static_map
            for omega_h, static_map in self.maps.items()
            if self.leads_to_optimum(static_map)
            and (static_map.interior or (self.doubted and not static_map.flat))
        }

    def leads_to_optimum(self, static_map: StaticMap) -> bool:
        """Return whether a map has its optimum in the amplitude's valley, or about there."""
        best, valley = static_map.best(), self.reference.valley()
        return bool(
            valley.low <= best <= valley.high or abs(best - self.reference.best()) < self.near
        )

    @property
    def clearest(self) -> tuple[float, StaticMap] | None:
        """The map with the most evidence, of those that lead there if any does; None: no map."""
        maps = self.usable or self.maps
        return max(maps.items(), key=lambda item: item[1].evidence, default=None)

    @property
    def evidence(self) -> float:
        """Evidence of the clearest map."""
        return self.clearest[1].evidence if self.clearest else 0.0


@dataclass(frozen=True)
class Findings:
    """Findings of a recording.

    Attributes
    ----------
    scale, dwells, static_map, period
        Theta's range; where it rested; map of the amplitude; the oscillation's period [s].
    name : str
        What the amplitude sums.
    costs : list of CostMaps
        One of each candidate.
    limits : ThetaLimits
        Limits of the controller's theta.
    modes : list of Mode
        Its parts, with the share and the best of each.
    doubt : str
        What is not sure about the optimum, in words; empty if it is.
    safe : SafeRange or None
        Thetas that keep the constraint.
    speed : float
        Of the optimum's motion [ranges/s].
    frequency : float
        Of most of the oscillation [Hz].
    """

    scale: Scale
    dwells: Dwells
    static_map: StaticMap
    period: float
    name: str
    costs: list[CostMaps]
    limits: ThetaLimits
    modes: list[Mode]
    doubt: str = ""
    safe: SafeRange | None = None
    speed: float = 0.0
    frequency: float = 0.0


def analyse(
    loaded: Loaded,
    rig: RigFile,
    training: BagTraining,
    amplitude: Amplitude | None = None,
    settings: TuningSettings = TUNING,
    safe: SafeRange | None = None,
) -> Findings:
    """Find where theta rested, and the static maps of the amplitude and of every cost.

    ``amplitude`` is the one of the excitation; without it, it is chosen from the recording.
    ``safe`` are the thetas that keep the constraint.

    Raises
    ------
    NoOptimum
        If there is none inside the range, or no cost shows it.
    koop_core.errors.InputError
        If theta was held at too few values.
    """
    dt, scale = rig.dt, rig.scale
    if amplitude is None:
        windows = Windows(window_length(period_of(loaded, dt), DESIGN.window, dt), dt)
        amplitude = Design(rig, find_holds(loaded, scale, windows.length), windows).amplitude
    if amplitude is None:
        raise NoOptimum("flat", f"no frequency of any channel reacts to theta: {TO_DO}")
    dwells = find_dwells(loaded, scale, amplitude, rig.sense)
    static_map, dwells = dwells.now(dwells.static_map(dwells.logs, rig.sense))
    powers = [amplitude.windows.powers(loaded.x[:, a:b].T) for _, a, b, _ in dwells.rests]
    settled = dwells.settled(powers)
    means = [power.mean(axis=0) for power in settled]
    period = amplitude.period(means)
    candidates: list[CostMaps] = []
    for cost in costs(loaded, training, period, settings.learned):
        maps = {}
        if cost.y_out is not None:
            for omega_h in dict.fromkeys(find_corners(settings.highpass, period, dt)):
                levels = dwells.window_levels(high_pass(cost.y_out, loaded, omega_h, dt))
                maps[omega_h] = dwells.static_map(levels, rig.sense)
        candidates.append(CostMaps(cost, maps, static_map, settings.near))
    findings = Findings(
        scale, dwells, static_map, period, amplitude.name(rig.names), candidates,
        limit_theta(static_map, rig, settings, safe),
        [_find_best(mode, dwells, powers, static_map, scale)
         for mode in amplitude.modes(settled, rig.names)],
        safe=safe,
        speed=static_map.motion / max(float(np.ptp(dwells.middles)) * dt, dt),
        frequency=amplitude.frequency(means),
    )  # fmt: skip
    return decide(findings, rig, settings)


def find_corners(factors: Sequence[float], period: float, dt: float) -> list[float]:
    """Return the omega_h that are tried [rad/s]: beyond half of the sampling rate there is none."""
    return [min(factor * 2.0 * math.pi / period, math.pi / dt) for factor in factors]


def _find_best(
    mode: Mode, dwells: Dwells, powers: list[Array], static_map: StaticMap, scale: Scale
) -> Mode:
    """Return a mode with its own best, from the powers of all windows of each rest."""
    logs = [0.5 * np.log(dwells.amplitude.part(mode, power)) for power in powers]
    own = dwells.static_map(logs, static_map.sense)
    best = own.best()
    step, error = own.difference(static_map.best(), best)
    return mode._replace(
        theta=scale.theta_at(best), best=own.sense * own.least,
        error=float(own.predict(np.array([best]))[1][0]),
        worse=math.exp(max(step - MAP.ends * error, 0.0)),
    )  # fmt: skip


STRONGER = "record a channel in which the oscillation is stronger"
TO_DO = (
    "run 'koop check' to see whether theta reaches the rig and what hides the oscillation, then "
    "record wider limits or longer holds (increase 'time')"
)


def decide(findings: Findings, rig: RigFile, settings: TuningSettings = TUNING) -> Findings:
    """Return the findings with their doubts; raise NoOptimum where there is none to seek."""
    static_map = findings.static_map
    if static_map.flat or float(np.ptp(static_map.mean)) < settings.slight:
        raise NoOptimum("flat", _flat(findings), findings)
    if not static_map.interior:
        end, safe = static_map.best_end, findings.safe
        if end is not None and safe is not None and safe.ends(upper=end > 0.0):
            findings = _doubted(findings, _at_bound(findings, rig, end))
        elif end is None or abs(static_map.motion) > settings.near:  # what moves may turn round
            findings = _doubted(findings, _doubt(static_map))
        else:
            raise NoOptimum("monotone", _monotone(findings, rig), findings)
    if not any(candidate.usable for candidate in findings.costs):
        findings = _doubted(
            findings, findings.doubt or "no cost shows the optimum of the amplitude beyond doubt"
        )
    if not any(candidate.usable for candidate in findings.costs):
        raise NoOptimum("drowned", _drowned(findings), findings)
    return findings


def _doubted(findings: Findings, doubt: str) -> Findings:
    costs = [replace(candidate, doubted=True) for candidate in findings.costs]
    return replace(findings, costs=costs, doubt=doubt)


def _doubt(static_map: StaticMap) -> str:
    """Return the doubt that a map without a clear optimum leaves."""
    limit = "min" if static_map.worse_by(0.0)[1] < static_map.worse_by(1.0)[1] else "max"
    return (
        f"the amplitude changes by {_change(static_map)} %, but whether it gets worse again "
        f"towards theta_{limit} is not certain (errors of {_error(static_map)} %): if not, theta "
        "will stay near that limit"
    )


def _at_bound(findings: Findings, rig: RigFile, end: float) -> str:
    return (
        f"the amplitude of {findings.name} is best at {findings.scale.theta_at(end):.4g}, where "
        f"the constraint {rig.constraint or 'between knobs'} ends theta's range: theta will stay "
        "near it"
    )


def _flat(findings: Findings) -> str:
    return (
        f"over theta's range the amplitude of {findings.name} varies by "
        f"{_change(findings.static_map)} %, with errors of {_error(findings.static_map)} %, and "
        f"shows no optimum: {TO_DO}"
    )


def _monotone(findings: Findings, rig: RigFile) -> str:
    low = findings.static_map.best_end == 0.0
    name, value = ("theta_min", rig.theta_min) if low else ("theta_max", rig.theta_max)
    return (
        f"the amplitude of {findings.name} is best at {name} = {value:g}, the limit: there is "
        f"nothing to seek; leave theta there, or record with a {name} beyond it"
    )


def _drowned(findings: Findings) -> str:
    best = findings.scale.theta_at(findings.static_map.best())
    seen = f"the amplitude of {findings.name} has an optimum near {best:.4g}, but"
    clearest = max(findings.costs, key=lambda each: each.evidence)
    if clearest.clearest and clearest.evidence > MAP.ends**2:
        other = findings.scale.theta_at(clearest.clearest[1].best())
        return (
            f"{seen} the cost {clearest.cost.name} leads to {other:.4g}: it sums what that "
            f"amplitude leaves out, which changes with theta too; {STRONGER}"
        )
    return (
        f"{seen} no cost shows it (evidence {clearest.evidence:.1f}): noise or interference "
        f"drowns it; {STRONGER}"
    )


def _change(static_map: StaticMap) -> str:
    return f"{100 * math.expm1(float(np.ptp(static_map.mean))):.2g}"


def _error(static_map: StaticMap) -> str:
    return f"{100 * float(np.median(static_map.error)):.2g}"
