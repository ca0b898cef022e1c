"""What a tuning saw, chose and expects, in JSON terms: ``tune.json``."""

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
from koop_tune.result.as_text import nodes_of, reasons_of
from koop_tune.result.parameter_text import KNOWN
from koop_tune.rig.rig_file import RigFile
from koop_tune.rig_model.static_map import GRID, StaticMap, weights_of
from koop_tune.search.prediction import PERCENTILES
from koop_tune.search.search import Outcome
from koop_tune.search.tuning import Judged, NoOptimum, Seen, Tuning

DRAWS = 200  # of the static map, that tell how sure the best theta is
EVERY = 4  # points of a curve that are kept, one of so many


def of_refusal(no: NoOptimum) -> dict[str, Any]:
    """Return what was seen, and why nothing was chosen."""
    return {"verdict": no.kind, "why": str(no), **of_seen(no.seen)}


def of_tuning(found: Tuning, rig: RigFile, model: Path | None) -> dict[str, Any]:
    """Return all of it."""
    return {
        "verdict": "tuned",
        "cost": found.chosen.cost.name,
        "why": found.why,
        "doubt": found.seen.doubt,
        "limits": found.seen.limits.why,
        "constants": asdict(found.best.constants),
        "score": math.exp(found.best.score),
        "time": found.time,
        **of_seen(found.seen, found),
        "predicted": found.prediction.as_json(),
        "paths": [_path(found, end) for end in (0, 1)],
        "parameters": _parameters(found, rig, model),
    }


def of_seen(seen: Seen, found: Tuning | None = None) -> dict[str, Any]:
    """Return what the recording shows."""
    maps = seen.amplitude
    curve = np.exp(maps.curve(maps.mean))[::EVERY]
    grid = np.asarray(np.linspace(0.0, 1.0, GRID)[::EVERY], np.float64)
    low, high = best_band(maps)
    return {
        "feature": seen.feature,
        "period": seen.period,
        "windows": {**seen.stays.how._asdict(), "feature": seen.stays.feature},
        "theta_best": seen.scale.theta_at(maps.best()),
        "theta_best_band": [seen.scale.theta_at(low), seen.scale.theta_at(high)],
        "static_map": {
            **_points(seen, maps, 1.0, "amplitude"),
            "curve": {
                "theta": seen.scale.theta(grid).tolist(),
                "amplitude": curve.tolist(),
            },
        },
        "costs": [_cost(judged, seen, found) for judged in seen.costs],
    }


def best_band(maps: StaticMap) -> tuple[float, float]:
    """Return between which positions the optimum lies in nine of ten maps of other visits.

    Between the values of theta nobody was: the optimum is taken once from the curve, which has its
    least at one of them, and once from a parabola through the best one and its neighbours.
    """
    rng = np.random.default_rng(0)
    grid = np.linspace(0.0, 1.0, GRID)
    found = []
    for _ in range(DRAWS):
        mean = maps.sense * maps.drawn(weights_of(maps, rng))
        found.append(float(grid[int(np.argmin(maps.sense * maps.curve(maps.sense * mean)))]))
        found.append(vertex(maps.u, mean))
    low, high = np.percentile(found, [PERCENTILES[0], PERCENTILES[-1]])
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


def _points(seen: Seen, maps: StaticMap, power: float, name: str) -> dict[str, Any]:
    """Return a map's points, errors (of the logarithm) and visits; exp(power * mean)."""
    return {
        "theta": seen.scale.theta(seen.stays.u).tolist(),
        name: np.exp(power * maps.mean).tolist(),
        "error": (power * maps.error).tolist(),
        "visits": [np.exp(power * own).tolist() for own in maps.visits],
    }


def _cost(judged: Judged, seen: Seen, found: Tuning | None) -> dict[str, Any]:
    """Return a cost and its clearest map, of the chosen one that with the chosen omega_h."""
    own: dict[str, Any] = {
        "name": judged.cost.name,
        "sure": judged.gain,
        "score": math.exp(judged.tried[0].score) if judged.tried else None,
        "problem": judged.cost.problem,
        "map": None,
    }
    if judged.maps:
        omega_h = max(judged.maps, key=lambda omega: judged.maps[omega].gain)
        if found is not None and judged.cost.name == found.chosen.cost.name:
            omega_h = found.best.constants.omega_h
        maps = judged.maps[omega_h]
        own["map"] = {
            "omega_h": omega_h,
            "theta_best": seen.scale.theta_at(maps.best()) if maps.interior else None,
            **_points(seen, maps, 2.0, "r"),  # r is the mean square of y_hp
        }
    return own


def _path(found: Tuning, end: int) -> dict[str, Any]:
    """Return theta and amplitude of the predicted runs from one end of the range, as bands."""
    scale, runs = found.seen.scale, found.runs[end::2]
    duration = found.prediction.duration
    blocks = runs[0].u.size
    theta = [scale.theta(np.clip(run.u, 0.0, 1.0)) for run in runs]
    return {
        "start": scale.theta_at(float(end)),
        "time": ((np.arange(blocks) + 0.5) * duration / blocks).tolist(),
        "theta": _bands(theta),
        "amplitude": _bands([_amplitude(run) for run in runs]),
    }


def _amplitude(run: Outcome) -> NDArray[np.float64]:
    return np.asarray(np.sqrt(run.power))


def _bands(rows: Sequence[NDArray[np.float64]]) -> dict[str, list[float]]:
    names = ("low", "middle", "high")
    bands = np.percentile(rows, PERCENTILES, axis=0)
    return {name: row.tolist() for name, row in zip(names, bands, strict=True)}


def _parameters(found: Tuning, rig: RigFile, model: Path | None) -> list[dict[str, Any]]:
    """Return each parameter that is not a default, with its unit and its reason."""
    reasons = reasons_of(found, rig)
    return [
        {
            "node": node,
            "name": item.name,
            "value": values[item.name],
            "unit": spec_of(item).unit,
            "meaning": spec_of(item).description,
            "reason": reasons[node].get(item.name, ""),
        }
        for node, values in nodes_of(found, rig, model).items()
        for item in parameters_of(KNOWN[node])
        if item.name in values
    ]
