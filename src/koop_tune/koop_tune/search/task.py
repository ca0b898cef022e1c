"""Models of the rig that are compatible with a recording, for the search."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from koop_identify.recording.loaded import Loaded
from koop_tune.excitation.static_map import GRID, StaticMap
from koop_tune.rig.rig_file import RigFile
from koop_tune.rig_model.dwells import Dwells
from koop_tune.rig_model.surrogate import Surrogate, Times, high_pass
from koop_tune.search.findings import CostMaps, Findings
from koop_tune.search.run import Task
from koop_tune.search.settings import TuningSettings


def make_task(
    loaded: Loaded, findings: Findings, cost: CostMaps, times: Times, time: float, rig: RigFile,
    settings: TuningSettings,
) -> Task:  # fmt: skip
    """Return models of the rig for one cost and each corner frequency."""
    y_out = cost.cost.y_out
    assert y_out is not None
    every = max(1, int(time / (settings.blocks * rig.dt)))
    parts, first = cut_segments(y_out, findings.dwells)
    begins = np.cumsum([0, *(part.size for part in parts)])
    recorded = np.concatenate(parts), begins, first
    fine: dict[float, list[Surrogate]] = {}
    coarse: dict[float, list[Surrogate]] = {}
    for omega_h, static_map in cost.usable.items():
        fine[omega_h] = draw_surrogates(findings, static_map, recorded, times, settings, rig.dt)
        filtered, _ = cut_segments(high_pass(y_out, loaded, omega_h, rig.dt), findings.dwells)
        blocks = [block_rms(part, every) for part in filtered]
        ends = np.cumsum([0, *(block.size for block in blocks)])
        coarse[omega_h] = [
            s._replace(y=np.concatenate(blocks), begins=ends, dt=every * rig.dt, coarse=True)
            for s in fine[omega_h]
        ]
    limits, safe = findings.limits, findings.safe
    slope = edge = 0.0
    if safe is not None and not safe.fixed and (slope := safe.slope(rig.scale)):
        limit = safe.high if safe.bound_high else safe.low
        edge = math.log(limit) if rig.scale.logarithmic else limit
        edge -= safe.margin_at(limit) / slope
    return Task(
        fine, coarse, rig.scale, rig.sense, time, rig.dt, rig.theta_rate, limits.low, limits.high,
        settings.search, findings.speed, limits.widest, slope, edge,
    )  # fmt: skip


def cut_segments(
    values: NDArray[np.float64], dwells: Dwells
) -> tuple[list[NDArray[np.float64]], NDArray[np.int64]]:
    """Return a signal during each rest after settling, without its mean, ordered by theta.

    The second array has the first segment of each value of theta.
    """
    by_level = sorted(dwells.rests, key=lambda d: d.level)
    parts = []
    for rest in by_level:
        part = values[rest.begin + rest.skip * dwells.length : rest.end]
        part = part[np.isfinite(part)]
        parts.append(part - part.mean() if part.size else np.zeros(2))
    return parts, np.searchsorted([d.level for d in by_level], np.arange(dwells.u.size + 1))


def block_rms(values: NDArray[np.float64], every: int) -> NDArray[np.float64]:
    """Return the root mean square of blocks."""
    every = min(every, values.size)
    whole = values[: values.size // every * every].reshape(-1, every)
    return np.asarray(np.sqrt((whole**2).mean(axis=1)))


def draw_surrogates(
    findings: Findings,
    static_map: StaticMap,
    recorded: tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]],
    times: Times,
    settings: TuningSettings,
    dt: float,
) -> list[Surrogate]:
    """Return models of the rig; the first one is as it was measured.

    ``recorded`` is y, begins and first of a :class:`koop_tune.rig_model.surrogate.Surrogate`.
    """
    rng = np.random.default_rng(settings.seed)
    normal = rng.standard_normal((settings.surrogates, GRID))
    normal[0] = 0.0
    shifts = np.r_[0.0, rng.normal(0.0, settings.tau_spread, settings.surrogates - 1)]
    u = findings.dwells.u
    levels, amplitudes = static_map.draw(normal), findings.static_map.draw(normal)
    return [
        Surrogate(
            level, amplitude, u, static_map.sense * static_map.predict(u)[0],
            *recorded, times._replace(usual=times.usual + float(shift)), dt, findings.scale.low,
            findings.scale.high, findings.scale.logarithmic, False,
        )
        for level, amplitude, shift in zip(levels, amplitudes, shifts, strict=True)
    ]  # fmt: skip
