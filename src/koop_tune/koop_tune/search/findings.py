"""What an excitation shows: the static map of the amplitude, and that of every cost."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from koop_core.errors import InputError
from koop_identify.model.compare import Cost, costs
from koop_identify.model.from_bags import BagTraining
from koop_identify.model.windows import period_of
from koop_identify.recording.loaded import Loaded
from koop_tune.excitation.features import Bands, choose_bands, window_length
from koop_tune.excitation.static_map import StaticMap
from koop_tune.rig.rig_file import RigFile
from koop_tune.rig.scale import Scale
from koop_tune.rig_model.dwells import Dwells, find_dwells
from koop_tune.rig_model.spectra import find_period
from koop_tune.rig_model.surrogate import high_pass
from koop_tune.search.limits import ThetaLimits, limit_theta
from koop_tune.search.settings import TUNING, TuningSettings


class NoOptimum(InputError):
    """There is no optimum to seek; ``kind`` is monotone, flat or drowned."""

    def __init__(self, kind: str, message: str, findings: Findings) -> None:
        super().__init__(message)
        self.kind = kind
        self.findings = findings


@dataclass(frozen=True)
class CostMaps:
    """A cost's static maps.

    Attributes
    ----------
    cost : Cost
        The cost.
    maps : dict of float to StaticMap
        Maps of the logarithm of y_hp, by omega_h [rad/s]; empty where the cost cannot be made.
    near : float
        Distance within which an optimum is the amplitude's, in ranges.
    reference : StaticMap, optional
        The amplitude's, if that does not show beyond doubt that there is an optimum.
    """

    cost: Cost
    maps: dict[float, StaticMap]
    near: float
    reference: StaticMap | None = None

    @property
    def usable(self) -> dict[float, StaticMap]:
        """Maps with an optimum inside; in doubt, also those that share the amplitude's optimum."""
        reference = self.reference
        return {
            omega_h: static_map
            for omega_h, static_map in self.maps.items()
            if static_map.interior
            or (
                reference is not None
                and not static_map.flat
                and self.leads_to(reference, static_map)
            )
        }

    def leads_to(self, reference: StaticMap, static_map: StaticMap) -> bool:
        """Return whether a map has its optimum where another one has it."""
        return abs(static_map.best() - reference.best()) < self.near

    @property
    def clearest(self) -> tuple[float, StaticMap] | None:
        """The map with the most evidence, and its omega_h; None where there is none."""
        return max(self.maps.items(), key=lambda item: item[1].evidence.gain, default=None)

    @property
    def evidence(self) -> float:
        """Evidence of the clearest map."""
        return self.clearest[1].evidence.gain if self.clearest else 0.0


@dataclass(frozen=True)
class Findings:
    """Findings of a recording.

    Attributes
    ----------
    scale, dwells, amplitude, period
        Theta's range; where it rested; static map of what is wanted; the oscillation's period [s].
    feature : str
        The amplitude that theta changes most.
    costs : list of CostMaps
        One of each candidate.
    limits : ThetaLimits
        Limits of the controller's theta.
    doubt : str
        What is not sure about the optimum, in words; empty if it is.
    """

    scale: Scale
    dwells: Dwells
    amplitude: StaticMap
    period: float
    feature: str
    costs: list[CostMaps]
    limits: ThetaLimits
    doubt: str = ""


def analyse(
    loaded: Loaded,
    rig: RigFile,
    training: BagTraining,
    bands: Bands | None = None,
    settings: TuningSettings = TUNING,
) -> Findings:
    """Find where theta rested, the static map of the amplitude, and that of every cost.

    Raises
    ------
    NoOptimum
        If there is none inside the range, or no cost shows it.
    koop_core.errors.InputError
        If theta rested at too few values.
    """
    dt, scale = rig.dt, rig.scale
    period = find_period(loaded, scale, dt) or period_of(loaded, dt)
    if bands is None:
        bands = choose_bands(loaded.x.T, window_length(period, settings.periods, dt), dt)
    dwells = find_dwells(loaded, scale, bands, period)
    amplitude = dwells.static_map(dwells.amplitude, rig.sense)
    feature = bands.names(rig.names)[dwells.feature]
    omega = 2.0 * math.pi / period
    candidates: list[CostMaps] = []
    for cost in costs(loaded, training, period, settings.learned):
        maps = {}
        if cost.y_out is not None:
            for factor in settings.highpass:
                filtered = high_pass(cost.y_out, loaded, factor * omega, dt)
                levels = dwells.window_levels(filtered)
                maps[factor * omega] = dwells.static_map(levels, rig.sense)
        candidates.append(CostMaps(cost, maps, settings.near))
    reference = _reference(amplitude, candidates, dwells, settings)
    limits = limit_theta(amplitude, reference, rig, settings)
    findings = Findings(scale, dwells, amplitude, period, feature, candidates, limits)
    return decide(findings, reference, rig, settings)


def _reference(
    amplitude: StaticMap, candidates: list[CostMaps], dwells: Dwells, settings: TuningSettings
) -> StaticMap:
    """Return the map in which the oscillation is clearest.

    An interference is part of the amplitude; of a contrast it is not.
    """
    reference = amplitude
    for candidate in candidates:
        if candidate.cost.name.startswith("contrast") and candidate.cost.y_out is not None:
            levels = dwells.window_levels(np.sqrt(np.nan_to_num(candidate.cost.y_out)))
            static_map = dwells.static_map(levels, amplitude.sense)
            if static_map.clarity > settings.clearer * reference.clarity:
                reference = static_map
    return reference


def decide(
    findings: Findings, reference: StaticMap, rig: RigFile, settings: TuningSettings
) -> Findings:
    """Return the findings with their doubts; raise NoOptimum where there is none to seek."""

    def refer(doubt: str) -> Findings:
        costs = [replace(candidate, reference=reference) for candidate in findings.costs]
        return replace(findings, costs=costs, doubt=doubt)

    flat = reference.flat or float(np.ptp(reference.mean)) < settings.slight
    if not reference.interior and flat:
        raise NoOptimum("flat", _flat(findings, reference), findings)
    if not reference.interior and not any(
        static_map.evidence.gain > settings.decides * static_map.settings.gain
        and candidate.leads_to(reference, static_map)
        for candidate in findings.costs
        for static_map in candidate.maps.values()
    ):  # no cost shows beyond doubt the optimum that the amplitude only suggests
        if reference.best_end is not None:
            raise NoOptimum("monotone", _monotone(findings, reference, rig), findings)
        findings = refer(_doubt(reference))
    if not any(candidate.usable for candidate in findings.costs):
        findings = refer(
            findings.doubt or "no cost shows the optimum of the amplitude beyond doubt"
        )
    if not any(candidate.usable for candidate in findings.costs):
        raise NoOptimum("drowned", _drowned(findings), findings)
    return findings


def _doubt(static_map: StaticMap) -> str:
    """Return the doubt that a map without a clear optimum leaves."""
    limit = "min" if static_map.evidence.rising else "max"
    return (
        f"the amplitude changes by {_change(static_map)} %, but whether it gets worse again "
        f"towards theta_{limit} is not certain (errors of {_error(static_map)} %): if not, theta "
        "will stay near that limit"
    )


def _flat(findings: Findings, static_map: StaticMap) -> str:
    return (
        f"over theta's range the amplitude of {findings.feature} varies by {_change(static_map)} "
        f"%, with errors of {_error(static_map)} %, and shows no optimum: run 'koop check' to see "
        "whether theta reaches the rig and what hides the oscillation, then record wider limits or "
        "longer rests (increase 'time')"
    )


def _monotone(findings: Findings, static_map: StaticMap, rig: RigFile) -> str:
    low = int(np.argmin(static_map.y)) == 0
    name, value = ("theta_min", rig.theta_min) if low else ("theta_max", rig.theta_max)
    return (
        f"the amplitude of {findings.feature} is best at {name} = {value:g}, the limit: there is "
        f"nothing to seek; leave theta there, or record with a {name} beyond it"
    )


def _drowned(findings: Findings) -> str:
    best = findings.scale.theta_at(findings.amplitude.best())
    evidence = max(0.0, *(candidate.evidence for candidate in findings.costs))
    return (
        f"the amplitude of {findings.feature} has an optimum near {best:.4g}, but no cost shows it "
        f"(evidence {evidence:.1f}): noise or interference drowns it; record longer rests "
        "(increase 'time'), or measure where the oscillation is stronger"
    )


def _change(static_map: StaticMap) -> str:
    return f"{100 * math.expm1(float(np.ptp(static_map.mean))):.2g}"


def _error(static_map: StaticMap) -> str:
    return f"{100 * float(np.median(static_map.error)):.2g}"
