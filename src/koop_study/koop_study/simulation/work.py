"""The functions that worker processes run; arguments and results are in JSON terms."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import ConfigError
from koop_loop.loop import LoopDiverged
from koop_loop.metrics import LOGGING_START
from koop_loop.static_map import settled as settled_cost
from koop_loop.thinning import extremes
from koop_loop.training import simulated_gram
from koop_study.simulation import maps
from koop_study.simulation.case import Case, case_of, override
from koop_study.simulation.run import DIVERGED, Row, loop_of, measure, run
from koopman_lifter.edmd import edmd
from koopman_lifter.modes import decompose, select

POINTS = 900  # that a drawn trace is thinned to


def check(work: str, arguments: dict[str, Any]) -> None:
    """Raise ConfigError if a work's settings cannot be used, before anything is computed."""
    settings = arguments.get("settings", {})
    if work == "modes":
        for name in settings:
            if name.partition(".")[0] not in ("plant", "training") or name == "training.seed":
                raise ConfigError(f"{name}: has no effect on the modes of seeds")
        override(Case(), settings)
    elif work in RUNS:
        case_of(settings, *arguments.get("seeds", [])[:1])


def runs(settings: dict[str, Any], seeds: list[int], with_r_star: bool = False) -> list[Any]:
    """Run closed loops and return the metrics of each seed."""
    return [_figures(case_of(settings, seed), with_r_star) for seed in seeds]


def _figures(case: Case, with_r_star: bool) -> Row:
    try:
        return measure(case, run(case), with_r_star)
    except LoopDiverged:
        return DIVERGED


def modes(settings: dict[str, Any], seed: int) -> dict[str, Any]:
    """Train a model and return its modes, largest |lambda| first."""
    case = override(Case(), {**settings, "training.seed": seed})
    gram, _ = simulated_gram(case.plant, case.training)
    decomposed = decompose(edmd(gram), gram)
    return {
        "real": decomposed.eigenvalues.real.tolist(),
        "imag": decomposed.eigenvalues.imag.tolist(),
        "energy": decomposed.energies.tolist(),
        "residual": decomposed.residuals.tolist(),
        "kept": select(decomposed, case.training.modes).tolist(),
    }


def ramp(settings: dict[str, Any], duration: float) -> dict[str, Any]:
    """Return the static map along a ramp: thinned for drawing, and binned."""
    case = case_of(settings)
    theta, r = maps.ramp(case, duration)
    low, high = _drawn(r)
    centres = theta[: low.size * (r.size // low.size)].reshape(low.size, -1).mean(axis=1)
    return {
        "theta": centres.tolist(),
        "low": low.tolist(),
        "high": high.tolist(),
        "mean": maps.binned(theta, r).tolist(),
    }


def settled(settings: dict[str, Any]) -> dict[str, Any]:
    """Return the settled static map: mean and the 10 and 90 % quantiles over a drift period."""
    loop = loop_of(case_of(settings))
    costs = [settled_cost(*loop, float(theta)) for theta in maps.grid()]
    return {  # unusable states have no cost
        "theta": maps.grid().tolist(),
        "mean": [float(np.nanmean(r)) for r in costs],
        "low": [float(np.nanquantile(r, 0.1)) for r in costs],
        "high": [float(np.nanquantile(r, 0.9)) for r in costs],
    }


def trace(settings: dict[str, Any]) -> dict[str, Any]:
    """Run one closed loop; return its signals, thinned, and metrics.

    They begin where the paper logs; those of a shorter run at its begin.
    """
    case = case_of(settings)
    done = run(case)
    first = round(LOGGING_START / case.plant.dt) if case.duration > LOGGING_START else 0
    signals = {"x": done.ground_truth[:, 0], "r": done.r, "theta": done.theta}
    every = max(1, (case.steps - first) // POINTS)
    return {
        "t": (done.t[first : first + every * POINTS : every]).tolist(),
        **{name: [part.tolist() for part in _drawn(x[first:])] for name, x in signals.items()},
        "metrics": measure(case, done, with_r_star=True),
    }


def _drawn(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    low, high = extremes(values, max(1, values.size // POINTS))
    return low[:POINTS], high[:POINTS]


RUNS = ("runs", "ramp", "settled", "trace")
