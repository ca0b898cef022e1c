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
from koop_tune.excitation.static_map import GRID, StaticMap
from koop_tune.result.as_text import list_parameters
from koop_tune.result.parameter_text import KNOWN
from koop_tune.rig.rig_file import RigFile
from koop_tune.search.findings import CostMaps, Findings, NoOptimum
from koop_tune.search.prediction import PERCENTILES
from koop_tune.search.tuning import Tuning

DRAWS = 200  # of the static map, that tell between which values the best theta lies
EVERY = 4  # points of a curve that are kept, one of so many


def of_refusal(no: NoOptimum) -> dict[str, Any]:
    """Return the findings, and why nothing was chosen."""
    return {"verdict": no.kind, "why": str(no), **of_seen(no.findings)}


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
    maps = findings.amplitude
    curve = np.exp(maps.curve(maps.mean))[::EVERY]
    grid = np.asarray(np.linspace(0.0, 1.0, GRID)[::EVERY], np.float64)
    low, high = best_band(maps)
    return {
        "feature": findings.feature,
        "period": findings.period,
        "windows": {**findings.dwells.bands._asdict(), "feature": findings.dwells.feature},
        "theta_best": findings.scale.theta_at(maps.best()),
        "theta_best_band": [findings.scale.theta_at(low), findings.scale.theta_at(high)],
        "static_map": {
            **_points(findings, maps, 1.0, "amplitude"),
            "curve": {
                "theta": findings.scale.theta(grid).tolist(),
                "amplitude": curve.tolist(),
            },
        },
        "costs": [_cost(candidate, findings, tuning) for candidate in findings.costs],
    }


def best_band(maps: StaticMap) -> tuple[float, float]:
    """Return the positions between which nine of ten resampled maps have their optimum.

    Between the values of theta nobody was: the optimum is taken once from the curve, which has its
    least at one of them, and once from a parabola through the best one and its neighbours.
    """
    rng = np.random.default_rng(0)
    grid = np.linspace(0.0, 1.0, GRID)
    positions = []
    for _ in range(DRAWS):
        mean = maps.sense * maps.reweigh(maps.draw_weights(rng))
        positions.append(float(grid[int(np.argmin(maps.sense * maps.curve(maps.sense * mean)))]))
        positions.append(vertex(maps.u, mean))
    low, high = np.percentile(positions, [PERCENTILES[0], PERCENTILES[-1]])
    return float(low), float(high)


def vertex(u: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Return where the parabola through the least point and its neighbours is least.

    >>> u = np.array([0.0, 1.0, 3.0, 4.0])
    >>> round(vertex(u, (u - 1.4) ** 2), 9)
    1.4
    """
    i = int(np.argmin(y))
    if i in (0, u.size - 1):
        return float(u[i])
    a, b, _ = np.polyfit(u[i - 1 : i + 2] - u[i], y[i - 1 : i + 2], 2)
    return float(u[i] - b / (2.0 * a)) if a > 0.0 else float(u[i])


def _points(findings: Findings, maps: StaticMap, power: float, name: str) -> dict[str, Any]:
    """Return a map's points, errors (of the logarithm) and visits; exp(power * mean)."""
    return {
        "theta": findings.scale.theta(findings.dwells.u).tolist(),
        name: np.exp(power * maps.mean).tolist(),
        "error": (power * maps.error).tolist(),
        "visits": [np.exp(power * levels).tolist() for levels in maps.visits],
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
