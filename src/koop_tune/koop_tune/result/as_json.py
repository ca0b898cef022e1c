"""A tuning as JSON: findings, choice and prediction, for ``tune.json``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_core.config.describe import parameters_of
from koop_core.config.parameter import spec_of
from koop_tune.excitation.static_map import StaticMap
from koop_tune.result.as_text import list_parameters
from koop_tune.result.parameter_text import KNOWN
from koop_tune.rig.rig_file import RigFile
from koop_tune.search.findings import CostMaps, Findings, NoOptimum
from koop_tune.search.prediction import PERCENTILES
from koop_tune.search.tuning import Tuning

EVERY = 4  # points of a curve that are kept, one of so many


def of_refusal(no: NoOptimum) -> dict[str, Any]:
    """Return the findings, and why nothing was chosen."""
    findings = of_seen(no.findings) if no.findings else {}
    return {"verdict": no.kind, "why": str(no), **findings}


def of_tuning(tuning: Tuning, rig: RigFile, model: Path | None) -> dict[str, Any]:
    """Return the findings, the choice and the prediction."""
    return {
        "verdict": "tuned",
        "cost": tuning.chosen.name,
        "why": tuning.why,
        "doubt": tuning.findings.doubt,
        "limits": tuning.findings.limits.why,
        "constants": asdict(tuning.best.constants),
        "score": math.exp(tuning.best.score),
        "time": tuning.time,
        **of_seen(tuning.findings, tuning),
        "predicted": tuning.prediction.as_json(),
        "paths": [_path(tuning, end) for end in (0, 1)],
        "parameters": _parameters(tuning, rig, model),
    }


def of_seen(findings: Findings, tuning: Tuning | None = None) -> dict[str, Any]:
    """Return the findings."""
    maps, scale = findings.static_map, findings.scale
    grid, valley = maps.grid[::EVERY], maps.valley()
    limits, dwells = findings.limits, findings.dwells
    floor = math.log(dwells.amplitude.floor) if maps.sense > 0.0 else -math.inf
    return {
        "feature": findings.name,
        "amplitude": dwells.amplitude.as_json(),
        "period": findings.period,
        "growth": findings.growth,
        "modes": [mode.describe(findings.channels) for mode in findings.modes],
        "theta_best": scale.theta_at(maps.best()),
        "best": {
            "log": maps.sense * maps.least,
            "error": min(maps.doubt, max(maps.least - floor, 0.0)),
            "valley": [
                min(scale.theta_at(valley.low), limits.low),
                max(scale.theta_at(valley.high), limits.high),
            ],
            "floor": dwells.amplitude.floor,
        },
        "static_map": {
            **_points(findings, maps, 1.0, "amplitude"),
            "curve": {
                "theta": scale.theta(grid).tolist(),
                "amplitude": np.exp(maps.curve[::EVERY]).tolist(),
                "error": maps.deviation[::EVERY].tolist(),
            },
        },
        "safe": findings.safe._asdict() if findings.safe else None,
        "costs": [_cost(candidate, findings, tuning) for candidate in findings.costs],
    }


def _points(findings: Findings, maps: StaticMap, power: float, name: str) -> dict[str, Any]:
    """Return a map's holds and errors (of the logarithm); exp(power * mean)."""
    return {
        "theta": findings.scale.theta(maps.u).tolist(),
        name: np.exp(power * maps.mean).tolist(),
        "error": (power * maps.error).tolist(),
    }


def _cost(candidate: CostMaps, findings: Findings, tuning: Tuning | None) -> dict[str, Any]:
    """Return a cost and its clearest map; for the chosen cost, the map of its omega_h."""
    name = candidate.cost.name
    scores = {s.name: math.exp(s.score) for s in tuning.searched} if tuning else {}
    values: dict[str, Any] = {
        "name": name,
        "evidence": candidate.evidence,
        "score": scores.get(name),
        "problem": candidate.cost.problem,
        "map": None,
    }
    if candidate.clearest is not None:
        omega_h, maps = candidate.clearest
        if tuning is not None and name == tuning.chosen.name:
            omega_h = tuning.best.constants.omega_h
            maps = candidate.maps[omega_h]
        values["map"] = {
            "omega_h": omega_h,
            "theta_best": findings.scale.theta_at(maps.best()) if maps.interior else None,
            **_points(findings, maps, 2.0, "r"),  # r is the mean square of y_hp
        }
    return values


def _path(tuning: Tuning, end: int) -> dict[str, Any]:
    """Return theta and amplitude of the predicted runs from one end of the range, as bands."""
    scale, runs = tuning.findings.scale, tuning.runs[end::2]
    duration = tuning.prediction.duration
    blocks = runs[0].u.size
    return {
        "start": scale.theta_at(float(end)),
        "time": ((np.arange(blocks) + 0.5) * duration / blocks).tolist(),
        "theta": _bands([scale.theta(np.clip(run.u, 0.0, 1.0)) for run in runs]),
        "amplitude": _bands([np.asarray(np.sqrt(run.power)) for run in runs]),
    }


def _bands(rows: Sequence[NDArray[np.float64]]) -> dict[str, list[float]]:
    names = ("low", "middle", "high")
    bands = np.percentile(rows, PERCENTILES, axis=0)
    return {name: row.tolist() for name, row in zip(names, bands, strict=True)}


def _parameters(tuning: Tuning, rig: RigFile, model: Path | None) -> list[dict[str, Any]]:
    """Return each parameter that is not a default, with its unit and its reason."""
    return [
        {
            "node": node,
            "name": item.name,
            "value": parameters[item.name][0],
            "unit": spec_of(item).unit,
            "meaning": spec_of(item).description,
            "reason": parameters[item.name][1],
        }
        for node, parameters in list_parameters(tuning, rig, model).items()
        for item in parameters_of(KNOWN[node])
        if item.name in parameters
    ]
