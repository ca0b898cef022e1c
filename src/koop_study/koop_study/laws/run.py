"""Run laws on plants and say how they did; the functions that worker processes run."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import njit
from koop_loop.metrics import evaluate
from koop_study.family import oscillator
from koop_study.family.oscillator import RigParams
from koop_study.laws import loop, outside
from koop_study.laws.catalogue import LAWS, Constants, trials
from koop_study.laws.plants import PlantConfig, Setting, setting

BAND = 0.6  # |theta - theta*| within which the paper's plant counts as converged, as everywhere
GOOD = 1.5  # amplitude over that at the best theta, within which a rig does
JUMP = 0.1  # change of theta* from one step to the next that is no drift
TAIL = 0.3  # share of a run at its end whose swing is looked at
WINDOW = 0.02  # of a run, that the way to the optimum is averaged over
POINTS = 900


@dataclass(frozen=True)
class Path:
    """Signals of one run, one row a step; see :func:`koop_study.laws.loop.drive`."""

    r: NDArray[np.float64]
    theta: NDArray[np.float64]
    amplitude: NDArray[np.float64]


def run(plant: Setting, name: str, constants: Constants, rivals: str = "") -> Path:
    """Run one law on one plant; ``rivals`` is the Python of those that are other programs."""
    path = Path(*(np.empty(plant.steps) for _ in range(3)))
    detector = {"omega_h": 20.0, "omega_l": 1.0, **constants}
    law, relay_state = plant.law(name, detector)
    sensing, state = plant.sensing(detector), plant.initial(relay_state)
    memory = loop.memory(plant.u)

    def go(state: loop.LoopState, first: int, last: int) -> loop.LoopState:
        return loop.drive(
            plant.is_rig, plant.plant, plant.exposure, plant.rig, plant.noise, sensing, law,
            memory, state, first, last, path.r, path.theta, path.amplitude,
        )  # fmt: skip

    if name == "oracle":
        go(state._replace(u=plant.best_u()), 0, plant.steps)
    elif LAWS[name].kind == loop.HOLD:
        asking = outside.rival(rivals, name, constants, plant.u, plant.seed)
        begin, hold = sensing.detector.settling, constants["hold"] * plant.time
        outside.ask_and_tell(asking, hold, plant, begin, go, state, path.r)
    else:
        go(state, 0, plant.steps)
    return path


@njit()
def _beside(
    p: RigParams, theta: NDArray[np.float64], gain: NDArray[np.float64], u: NDArray[np.float64]
) -> None:
    """Fill in L(theta) over L* at each time, from 1 upwards, and the position of theta."""
    for k in range(theta.shape[0]):
        u[k] = oscillator.position(p, theta[k])
        ratio = oscillator.level(p, u[k], k * p.dt) / p.level
        gain[k] = ratio if p.sense > 0.0 else 1.0 / ratio


def first_good(p: RigParams, theta: NDArray[np.float64]) -> int | None:
    """Return the first step up to which the mean of 2 % of a run is within 1.5 times the best."""
    away, u = np.empty(theta.size), np.empty(theta.size)
    _beside(p, theta, away, u)
    return _first_within(away, GOOD, max(1, round(WINDOW * theta.size)))


def measure(plant: Setting, path: Path, oracle: Path | None) -> dict[str, Any]:
    """Return how a run did.

    Returns
    -------
    dict
        ``score``: on the paper's plant IAE; on a rig the rms amplitude over the second half of the
        run over that of the best fixed theta with the same noise (its inverse where the amplitude
        is to be maximised). ``failed``: 1 where the paper's tail error is above 0.6 or the rig's
        score above 1.5. ``swing``: the 5 to 95 % range of theta over the last 30 %, as a share of
        its range. ``converged``: when the mean over 2 % of the run first is within the same
        bounds, in seconds or in the rig's times; None if never. ``reacquired``: the same after
        each jump of the optimum, None where it did not before the next one.
    """
    t = plant.t()
    tail = path.theta[round((1.0 - TAIL) * plant.steps) :]
    if plant.truth is None:
        displaced = plant.exposure.displaced
        aligned = path.theta - displaced if displaced.size else path.theta
        found = evaluate(t, aligned, path.r, plant.plant.theta_star, None)
        away, bound, unit = np.abs(aligned - plant.plant.theta_star), BAND, 1.0
        low, high = plant.plant.theta_min, plant.plant.theta_max
        tail = (tail - low) / (high - low)
        jumps = np.flatnonzero(np.abs(np.diff(displaced)) > JUMP) + 1
        score, failed = found.iae_theta, not found.converged
    else:
        assert oracle is not None
        away, u = np.empty(plant.steps), np.empty(plant.steps)
        _beside(plant.rig, path.theta, away, u)
        half = plant.steps // 2
        ratio = _rms(path.amplitude[half:]) / _rms(oracle.amplitude[half:])
        score = ratio if plant.sense > 0.0 else 1.0 / ratio
        bound, unit, tail = GOOD, plant.time, u[-tail.size :]
        failed = score > GOOD
        p = plant.rig
        every = p.jump_every if p.jump != 0.0 else math.inf
        jumps = np.array([round(i * every / p.dt) for i in range(1, int(t[-1] / every) + 1)], int)
    width = max(1, round(WINDOW * plant.steps))
    ends = [*jumps.tolist(), plant.steps]
    times = [
        _first_within(away[a:b], bound, min(width, b - a) if i == 0 else 1)
        for i, (a, b) in enumerate(zip([0, *ends[:-1]], ends, strict=True))
        if b - a > 1
    ]
    scaled = [None if k is None else k * plant.dt / unit for k in times]
    whole = len(scaled) if len(scaled) < 2 else len(scaled) - 1  # the last one may be cut short
    return {
        "score": float(score),
        "failed": float(failed),
        "swing": float(np.subtract(*np.quantile(tail, [0.95, 0.05]))),
        "converged": scaled[0],
        "reacquired": scaled[1:whole],
    }


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _first_within(away: NDArray[np.float64], bound: float, width: int) -> int | None:
    """Return the first sample up to which the mean of the last ``width`` is within ``bound``."""
    sums = np.concatenate([[0.0], np.cumsum(away)])
    means = (sums[width:] - sums[:-width]) / width
    inside = np.flatnonzero(means <= bound)
    return int(inside[0]) + width - 1 if inside.size else None


def law_trials(
    plant: dict[str, Any], law: str, count: int, seeds: list[int], rivals: str = ""
) -> list[list[float]]:
    """Return each trial's loss, a row a seed: the logarithm of the score, so that none rules."""
    tried = trials(law, count)
    return [
        [math.log(max(row["score"], 1e-3)) for row in _of_seed(plant, law, tried, seed, rivals)]
        for seed in seeds
    ]


def law_runs(
    plant: dict[str, Any], law: str, constants: Constants, seeds: list[int], rivals: str = ""
) -> list[dict[str, Any]]:
    """Return how a law did, one row a seed."""
    return [_of_seed(plant, law, [constants], seed, rivals)[0] for seed in seeds]


def _of_seed(
    plant: dict[str, Any], law: str, tried: list[Constants], seed: int, rivals: str
) -> list[dict[str, Any]]:
    drawn, oracle = _drawn(json.dumps(plant, sort_keys=True), seed)
    return [measure(drawn, run(drawn, law, one, rivals), oracle) for one in tried]


@lru_cache(maxsize=4)  # as many as a unit of work has: the next law's unit has the same ones
def _drawn(plant: str, seed: int) -> tuple[Setting, Path | None]:
    """Return a plant, and on a rig what the oracle does there."""
    drawn = setting(PlantConfig(**json.loads(plant)), seed)
    return drawn, run(drawn, "oracle", {}) if drawn.is_rig else None


def law_trace(plant: dict[str, Any], law: str, constants: Constants, seed: int) -> dict[str, Any]:
    """Return theta of one run, thinned for drawing, and where the optimum was."""
    drawn = setting(PlantConfig(**plant), seed)
    path = run(drawn, law, constants)
    every = max(1, drawn.steps // POINTS)
    t = drawn.t()[::every]
    if drawn.truth is None:
        away = drawn.exposure.displaced
        best = drawn.plant.theta_star + (away[::every] if away.size else np.zeros(t.size))
    else:
        best = np.array([drawn.truth.best(time)[0] for time in t])
    return {"t": t.tolist(), "theta": path.theta[::every].tolist(), "best": best.tolist()}


WORK: dict[str, Callable[..., Any]] = {
    "law_trials": law_trials,
    "law_runs": law_runs,
    "law_trace": law_trace,
}
