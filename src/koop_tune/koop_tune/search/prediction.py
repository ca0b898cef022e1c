"""Prediction of the tuned loop from runs on surrogates: figures with their bands."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from koop_tune.excitation.holds import mean_level
from koop_tune.excitation.static_map import GRID
from koop_tune.rig_model.dwells import Dwells
from koop_tune.search.findings import Findings
from koop_tune.search.run import Outcome, Task, try_out
from koop_tune.search.search import Trial

PERCENTILES = (5.0, 50.0, 95.0)


@dataclass(frozen=True)
class Band:
    """A figure with its band: 5 %, median and 95 % of the runs; infinite is never."""

    low: float
    middle: float
    high: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Band:
        """Return the band of values."""
        low, middle, high = np.percentile(values, PERCENTILES, method="nearest")
        return cls(float(low), float(middle), float(high))

    def as_text(self, unit: float = 1.0) -> str:
        """Return it in words, in units of ``1 / unit``.

        >>> Band(10.0, 20.0, math.inf).as_text()
        '20 (10 to never)'
        """
        low, middle, high = (
            "never" if math.isinf(value) else f"{unit * value:.3g}"
            for value in (self.low, self.middle, self.high)
        )
        return f"{middle} ({low} to {high})"


@dataclass(frozen=True)
class Prediction:
    """Predicted figures of the loop from either end of theta's range.

    Attributes
    ----------
    converges : Band
        Time until the amplitude is near its best [s].
    distance : Band
        Mean distance of theta from the best [u] once it has.
    excess : Band
        Amplitude then over the best one (its inverse where it is to be large).
    reduction : Band
        Amplitude at the start over the amplitude then (its inverse).
    duration : float
        Length of a run [s]; the second half counts as converged.
    runs : int
        Number of runs.
    """

    converges: Band
    distance: Band
    excess: Band
    reduction: Band
    duration: float
    runs: int


def predict(
    task: Task, trial: Trial, findings: Findings, seed: int, count: int
) -> tuple[Prediction, list[Outcome]]:
    """Run the chosen constants some times, with fresh random numbers."""
    runs = [try_out(task, trial.constants, n, seed) for n in range(count)]
    return describe_runs(task, runs, findings, seed), runs


def describe_runs(task: Task, runs: list[Outcome], findings: Findings, seed: int) -> Prediction:
    """Return the bands of some runs.

    What the amplitude of a time as long as half a run differs by itself, and the error of the best
    one, widen the bands.
    """
    count = len(runs)
    wander = find_wander(findings.dwells, 0.5 * task.steps)
    error = float(findings.static_map.deviation[round(findings.static_map.best() * (GRID - 1))])
    rng = np.random.default_rng(seed)
    noise = np.exp(math.hypot(wander, error) * rng.standard_normal(count)).tolist()
    return Prediction(
        Band.of([o.converged for o in runs]),
        Band.of([o.distance for o in runs]),
        Band.of([o.excess * e for o, e in zip(runs, noise, strict=True)]),
        Band.of([o.reduction / e for o, e in zip(runs, noise, strict=True)]),
        task.steps * task.dt,
        count,
    )


def find_wander(dwells: Dwells, samples: float) -> float:
    """Return the spontaneous deviation of the log amplitude over some samples."""
    errors = []
    for values in dwells.settled(dwells.logs):
        error = float(mean_level(np.exp(2.0 * values))[1])
        if math.isfinite(error):
            errors.append(error * math.sqrt(values.size * dwells.length / samples))
    return float(np.median(errors)) if errors else 0.0
