"""The result of a tuning: what ``tune.json`` keeps of findings, choice and prediction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from koop_core.config.describe import parameters_of
from koop_core.config.parameter import spec_of
from koop_tune.excitation.static_map import Interval, StaticMap
from koop_tune.result.as_text import list_parameters
from koop_tune.result.parameter_text import KNOWN
from koop_tune.result.tune_result import (
    AmplitudeMap,
    ControllerResult,
    CostResult,
    Curves,
    LoopPath,
    ParameterResult,
    Points,
    TuneResult,
)
from koop_tune.rig.scale import Scale
from koop_tune.search.findings import CostMaps, Findings, NoOptimum
from koop_tune.search.prediction import PERCENTILES
from koop_tune.search.tune_knobs import KnobsTuning
from koop_tune.search.tuning import Tuning

EVERY = 4  # points of a curve that are kept, one of so many


def summarise_refusal(no: NoOptimum) -> TuneResult:
    """Return the findings, and why nothing was chosen."""
    if no.findings is None:
        return TuneResult(no.kind, str(no))
    costs = [_summarise_cost(candidate, no.findings) for candidate in no.findings.costs]
    return TuneResult(no.kind, str(no), _summarise_map(no.findings, no.knob), costs)


def summarise(tuned: KnobsTuning, model: Path | None = None) -> TuneResult:
    """Return the findings, the choice and the prediction."""
    tuning, several = tuned.tuning, tuned.rig.count > 1
    findings = tuning.findings
    controller = ControllerResult(
        tuning.chosen.name, findings.doubt, tuning.best.constants, tuning.time, tuned.prediction,
        [] if several else [_draw_path(tuning, end) for end in (0, 1)],
        _list_parameters(tuned, model),
    )  # fmt: skip
    costs = [_summarise_cost(candidate, findings, tuning) for candidate in findings.costs]
    maps = {
        k: _summarise_map(
            replace(
                findings, static_map=section, scale=tuned.rigs[k].scale, limits=tuned.limits[k]
            ), k
        )
        for k, section in tuned.sections.items()
    }  # fmt: skip
    searched = maps.pop(tuned.knob)
    return TuneResult("tuned", tuning.why, searched, costs, controller, [*maps.values()])


def _summarise_map(findings: Findings, knob: int = 0) -> AmplitudeMap:
    maps, scale, limits = findings.static_map, findings.scale, findings.limits
    amplitude = findings.dwells.amplitude
    low, high = map(scale.theta_at, maps.valley())
    # narrower limits may leave some room beyond it
    low = min(low, limits.low) if limits.low > scale.low else low
    high = max(high, limits.high) if limits.high < scale.high else high
    floor = math.log(amplitude.floor) if maps.sense > 0.0 else -math.inf
    curve = (scale.theta(maps.grid), np.exp(maps.curve), maps.deviation)
    return AmplitudeMap(
        findings.name,
        amplitude,
        findings.modes,
        scale.theta_at(maps.best()),
        maps.sense * maps.least,
        min(maps.doubt, max(maps.least - floor, 0.0)),
        Interval(low, high),
        maps.motion,
        findings.period,
        findings.dwells.growth,
        _list_points(scale, maps, 1.0),
        Points(*(values[::EVERY].tolist() for values in curve)),
        knob,
    )


def _list_points(scale: Scale, maps: StaticMap, power: float) -> Points:
    """Return a map's holds: exp(power * mean)."""
    order = np.argsort(maps.u, kind="stable")
    columns = (scale.theta(maps.u), np.exp(power * maps.mean), power * maps.error)
    return Points(*(values[order].tolist() for values in columns))


def _summarise_cost(
    candidate: CostMaps, findings: Findings, tuning: Tuning | None = None
) -> CostResult:
    """Return a cost and its clearest map; for the chosen cost, the map of its omega_h."""
    name, best, points = candidate.cost.name, None, None
    scores = {s.name: math.exp(s.score) for s in tuning.searched} if tuning else {}
    if candidate.clearest is not None:
        maps = candidate.clearest[1]
        if tuning is not None and name == tuning.chosen.name:
            maps = candidate.maps[tuning.best.constants.omega_h]
        best = findings.scale.theta_at(maps.best()) if candidate.usable else None
        points = _list_points(findings.scale, maps, 2.0)  # r is the mean square of y_hp
    return CostResult(
        name, candidate.evidence, scores.get(name), candidate.cost.problem, best, points
    )


def _draw_path(tuning: Tuning, end: int) -> LoopPath:
    """Return theta and amplitude of the predicted runs from one end of the range."""
    scale, runs = tuning.findings.scale, tuning.runs[end::2]
    blocks = runs[0].u.size
    return LoopPath(
        scale.theta_at(float(end)),
        ((np.arange(blocks) + 0.5) * tuning.prediction.duration / blocks).tolist(),
        _draw_band([scale.theta(np.clip(run.u, 0.0, 1.0)) for run in runs]),
        _draw_band([np.asarray(np.sqrt(run.power)) for run in runs]),
    )


def _draw_band(rows: Sequence[NDArray[np.float64]]) -> Curves:
    return Curves(*np.percentile(rows, PERCENTILES, axis=0).tolist())


def _list_parameters(tuned: KnobsTuning, model: Path | None) -> list[ParameterResult]:
    """Return each parameter that is not a default, with its unit and its reason."""
    return [
        ParameterResult(item.name, value, spec_of(item).unit, reason, node)
        for node, parameters in list_parameters(tuned, model).items()
        for item in parameters_of(KNOWN[node])
        if item.name in parameters
        for value, reason in [parameters[item.name]]
    ]
