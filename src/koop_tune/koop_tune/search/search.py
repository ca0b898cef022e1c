"""The search for the constants of a controller on surrogates of the rig.

Constants are drawn by a Sobol sequence from ranges in units of the rig's own: its period, its time
T = tau + two periods, its range of theta. Each is judged by runs from both ends of the range, on
several surrogates, with the optimum at rest and in motion; the better half gets more runs
(successive halving; Jamieson and Talwalkar 2016), then the surroundings of the best are drawn from
once more. A run's score is

    log(amplitude over its second half / least amplitude) + slowness (share of the run to converge)

and a constant's score the 90th percentile over its runs. Of constants that score alike those are
taken that serve most rigs: a surrogate is not the rig, and what is best on it by a hair may
be far from what any rig has needed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from koop_tune.search.run import Constants, Outcome, Task, try_out

SEARCHED = ("omega_l", "speed", "dwell", "tau_f", "step_ratio")  # besides law and omega_h


def draw(task: Task, count: int, seed: int) -> list[Constants]:
    """Return constants from all over the ranges."""
    from scipy.stats import qmc  # slow to import

    high = sorted(task.surrogates)
    points = qmc.Sobol(len(SEARCHED) + 2, seed=seed).random(count)
    drawn = []
    for point in points:
        values = {}
        for name, x in zip(SEARCHED, point, strict=False):
            low, _, top = getattr(task.settings, name)
            values[name] = low * (top / low) ** x
        omega_h = high[min(int(point[-2] * len(high)), len(high) - 1)]
        law = "relay" if point[-1] < task.settings.relays else "adaptive"
        drawn.append(_in_units(task, law, omega_h, values))
    return drawn


def _in_units(task: Task, law: str, omega_h: float, v: dict[str, float]) -> Constants:
    t, limit = task.time, task.rate_of_steps / task.scale.span  # which may be below the fastest
    return Constants(
        law, omega_h, v["omega_l"] / t, min(v["speed"] / t, limit), v["dwell"] * t, v["tau_f"] * t,
        v["step_ratio"],
    )  # fmt: skip


def draw_near(
    centres: Sequence[Constants], count: int, rng: np.random.Generator, spread: float
) -> list[Constants]:
    """Return constants near some."""
    drawn = []
    for i in range(count):
        c = centres[i % len(centres)]
        values: dict[str, Any] = {
            name: getattr(c, name) * math.exp(rng.normal(0.0, spread)) for name in SEARCHED
        }
        values["step_ratio"] = min(max(values["step_ratio"], 0.01), 1.0)
        drawn.append(replace(c, **values))
    return drawn


def list_anchors(task: Task) -> list[Constants]:
    """Return constants that serve many rigs."""
    high = sorted(task.surrogates)
    omega_h = high[min(2, len(high) - 1)]
    return [
        _in_units(task, law, omega_h, {**_usual(task), "speed": speed, "dwell": dwell})
        for law in ("relay", "adaptive")
        for speed in task.settings.speeds
        for dwell in task.settings.dwells
    ]


def _usual(task: Task) -> dict[str, float]:
    return {name: getattr(task.settings, name)[1] for name in SEARCHED}


def unusual(task: Task, c: Constants) -> float:
    """Return the penalty of constants that are not the usual ones."""
    usual = _in_units(task, c.law, c.omega_h, _usual(task))
    far = [math.log(getattr(c, name) / getattr(usual, name)) / math.log(3.0) for name in SEARCHED]
    return task.settings.unusual * sum(x * x for x in far)


@dataclass(frozen=True)
class Trial:
    """Constants and the outcomes of their runs; ``percentile`` of their scores counts."""

    constants: Constants
    outcomes: list[Outcome]
    unusual: float
    percentile: float

    @property
    def score(self) -> float:
        """Percentile of the runs' scores."""
        return float(np.percentile([o.score for o in self.outcomes], self.percentile))

    @property
    def rank(self) -> float:
        """Score with the penalty of unusual constants; the least is the best."""
        return self.score + self.unusual


def search(
    task: Task,
    effort: float,
    seed: int,
    workers: int = 1,
) -> list[Trial]:
    """Return the best constants first, the better half of each round having run more often.

    ``effort`` is the search budget (1 = default), ``workers`` the number of threads.
    """
    s = task.settings
    first = 2 ** max(round(math.log2(s.first * effort)), 3)
    rng = np.random.default_rng([seed, 7])

    with ThreadPoolExecutor(workers) as pool:

        def run_more(trials: list[Trial], upto: int) -> list[Trial]:
            def results(t: Trial) -> list[Outcome]:
                done = range(len(t.outcomes), upto)
                return [try_out(task, t.constants, n, seed, fine=False) for n in done]

            pairs = zip(trials, pool.map(results, trials), strict=True)
            longer = [replace(t, outcomes=t.outcomes + outcomes) for t, outcomes in pairs]
            return sorted(longer, key=lambda t: t.rank)

        def begin(constants: Sequence[Constants], runs: int) -> list[Trial]:
            return run_more([Trial(c, [], unusual(task, c), s.percentile) for c in constants], runs)

        trials = begin([*list_anchors(task), *draw(task, first, seed)], 2)
        trials = run_more(trials[: first // 4], 8)
        for spread in (0.35, 0.2):
            near = draw_near([t.constants for t in trials[:4]], first // 4, rng, spread)
            trials = sorted([*begin(near, 8), *trials], key=lambda t: t.rank)
        return run_more(trials[: s.top], 24)


def confirm(task: Task, trials: Sequence[Trial], seed: int) -> list[Trial]:
    """Return the best constants, run sample by sample; the best first."""
    numbers = range(task.settings.fine_runs)
    confirmed = [
        replace(t, outcomes=[try_out(task, t.constants, n, seed) for n in numbers])
        for t in trials[: task.settings.fine]
    ]
    return sorted(confirmed, key=lambda t: t.rank)
