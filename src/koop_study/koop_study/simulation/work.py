"""The functions that worker processes run; arguments and results are in JSON terms."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import ConfigError
from koop_loop.thinning import extremes
from koop_study.simulation import maps
from koop_study.simulation.case import DRAWN, Case, override, seeded
from koop_study.simulation.learning import learn
from koop_study.simulation.run import measure, run
from koop_study.simulation.scenario import ScenarioConfig
from koopman_lifter.edmd import edmd
from koopman_lifter.modes import decompose, select

POINTS = 900  # that a drawn trace is thinned to


def case_of(settings: dict[str, Any], seed: int | None) -> Case:
    """Return the case of some settings; without a seed, everything is as in the paper.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If a setting is unknown or would have no effect, or the parts do not fit together.
    """
    case = override(Case(), settings)
    if seed is None:
        return case
    for name in DRAWN:
        if name in settings:
            raise ConfigError(f"{name}: is drawn from the seeds of the experiment")
    return seeded(case, seed)


def check(work: str, arguments: dict[str, Any]) -> None:
    """Raise ConfigError if a work's settings cannot be used, before anything is computed."""
    settings, seeds = arguments["settings"], arguments.get("seeds", [arguments.get("seed")])
    if work == "modes":
        for name in settings:
            if name.partition(".")[0] not in ("plant", "training") or name == "training.seed":
                raise ConfigError(f"{name}: has no effect on the modes of seeds")
        override(Case(), settings)
    else:
        case_of(settings, seeds[0])


def runs(settings: dict[str, Any], seeds: list[int], with_r_star: bool = False) -> list[Any]:
    """Run closed loops and return the metrics of each seed."""
    cases = [case_of(settings, seed) for seed in seeds]
    return [
        measure(case, run(case), maps.optimal_cost(case) if with_r_star else None) for case in cases
    ]


def modes(settings: dict[str, Any], seed: int) -> dict[str, Any]:
    """Train a model and return its modes, largest |lambda| first."""
    case = override(Case(), {**settings, "training.seed": seed})
    learned = learn(case.plant, ScenarioConfig(), case.training, case.sensing)
    koopman = edmd(learned.gram)
    found = decompose(koopman, learned.gram)
    kept = select(found, case.training.modes)
    return {
        "real": found.eigenvalues.real.tolist(),
        "imag": found.eigenvalues.imag.tolist(),
        "energy": found.energies.tolist(),
        "residual": found.residuals.tolist(),
        "kept": kept.tolist(),
        "condition": koopman.condition,
    }


def ramp(settings: dict[str, Any], seed: int | None, duration: float) -> dict[str, Any]:
    """Return the static map along a ramp: thinned for drawing, and binned."""
    case = case_of(settings, seed)
    theta, r = maps.ramp(case, duration)
    low, high = _drawn(r)
    centres = theta[: low.size * (r.size // low.size)].reshape(low.size, -1).mean(axis=1)
    return {
        "theta": centres.tolist(),
        "low": low.tolist(),
        "high": high.tolist(),
        "binned": maps.binned(theta, r).tolist(),
    }


def settled(settings: dict[str, Any], seed: int | None) -> dict[str, Any]:
    """Return the settled static map: mean and the 10 and 90 % quantiles over a drift period."""
    case = case_of(settings, seed)
    costs = [maps.settled(case, float(theta)) for theta in maps.grid()]
    return {  # unusable states have no cost
        "mean": [float(np.nanmean(r)) for r in costs],
        "low": [float(np.nanquantile(r, 0.1)) for r in costs],
        "high": [float(np.nanquantile(r, 0.9)) for r in costs],
    }


def trace(settings: dict[str, Any], seed: int | None, start: float) -> dict[str, Any]:
    """Run one closed loop and return its signals from ``start`` [s] on, thinned, and metrics."""
    case = case_of(settings, seed)
    done = run(case)
    first = round(start / case.plant.dt)
    x_low, x_high = _drawn(done.ground_truth[first:, 0])
    r_low, r_high = _drawn(done.r[first:])
    theta_min, theta_max = _drawn(done.theta[first:])
    every = (case.steps - first) // POINTS
    return {
        "t": (done.t[first : first + every * POINTS : every]).tolist(),
        "x": [x_low.tolist(), x_high.tolist()],
        "r": [r_low.tolist(), r_high.tolist()],
        "theta": [theta_min.tolist(), theta_max.tolist()],
        "metrics": measure(case, done, maps.optimal_cost(case)),
    }


def _drawn(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    low, high = extremes(values, max(1, values.size // POINTS))
    return low[:POINTS], high[:POINTS]


WORK: dict[str, Callable[..., Any]] = {
    "runs": runs,
    "modes": modes,
    "ramp": ramp,
    "settled": settled,
    "trace": trace,
}
