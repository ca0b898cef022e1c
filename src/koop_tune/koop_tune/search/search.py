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
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from koop_tune.rig.scale import Scale
from koop_tune.rig_model import surrogate
from koop_tune.rig_model.surrogate import BLOCKS, Surrogate
from koop_tune.search.settings import SEARCH, SearchSettings
from koopman_lifter import cost
from koopman_lifter.config import LifterConfig
from relay_esc.config import EscConfig

SEARCHED = ("omega_l", "speed", "dwell", "tau_f", "step_ratio")  # besides law and omega_h


@dataclass(frozen=True)
class Constants:
    """What is searched, in SI units.

    Attributes
    ----------
    law : str
        relay or adaptive.
    omega_h, omega_l : float
        Corner frequencies of the detector [rad/s].
    speed : float
        Speed of theta [ranges/s].
    dwell, tau_f : float
        Dwell time and filter of the relay [s].
    step_ratio : float
        Smallest step of the adaptive law over the largest.
    """

    law: str
    omega_h: float
    omega_l: float
    speed: float
    dwell: float
    tau_f: float
    step_ratio: float


@dataclass(frozen=True)
class Task:
    """A rig and a cost to be controlled.

    Attributes
    ----------
    surrogates, coarse : dict of float to list of Surrogate
        Rigs by omega_h [rad/s]: sample by sample, and in blocks.
    scale : Scale
        Theta's range in the rig file.
    sense : float
        +1 to minimise, else -1.
    time : float
        T [s].
    dt : float
        Sampling time [s].
    rate : float
        Largest change of theta per second.
    low, high : float
        Limits of the controller's theta, inside the range.
    settings : SearchSettings
        How constants are drawn and judged.
    """

    surrogates: dict[float, list[Surrogate]]
    coarse: dict[float, list[Surrogate]]
    scale: Scale
    sense: float
    time: float
    dt: float
    rate: float
    low: float
    high: float
    settings: SearchSettings = SEARCH

    @property
    def steps(self) -> int:
        """Samples of a run."""
        shortest = max(self.time, 0.2 * (self.scale.high - self.scale.low) / self.rate)
        return round(self.settings.length * shortest / self.dt)

    @property
    def rate_of_steps(self) -> float:
        """Largest change per second of what the relay steps: of log theta at its largest, if so."""
        return self.rate / self.scale.high if self.scale.logarithmic else self.rate


@dataclass(frozen=True)
class Outcome:
    """What one run came to.

    Attributes
    ----------
    excess : float
        Amplitude over the second half over the best one, at least about 1.
    converged : float
        Time to converge [s]; infinite if never.
    distance : float
        Mean of abs(u - u*) over the second half.
    reduction : float
        Amplitude at the start over that of the second half.
    u, power : ndarray, shape (BLOCKS,)
        Where theta was, and the mean square of the amplitude.
    score : float
        Score, as at the top of this file.
    """

    excess: float
    converged: float
    distance: float
    reduction: float
    u: NDArray[np.float64]
    power: NDArray[np.float64]
    score: float


def make_esc(task: Task, c: Constants, theta: float) -> EscConfig:
    """Return the controller's configuration with theta at the start."""
    rate = task.rate_of_steps
    return EscConfig(
        law=c.law,
        theta_scale="log" if task.scale.logarithmic else "linear",
        step_size=min(rounded(c.speed * task.dt * task.scale.span), rate * task.dt),
        step_ratio=rounded(c.step_ratio),
        dwell=rounded(c.dwell),
        tau_f=rounded(c.tau_f),
        theta_min=task.low,
        theta_max=task.high,
        rate_limit=rate,
        objective="minimise" if task.sense > 0.0 else "maximise",
        theta_initial=theta,
        epsilon_initial=1,
        dt=task.dt,
    )


def slow_down(esc: EscConfig, every: int, dt: float) -> EscConfig:
    """Return a controller that does with one of ``every`` samples what this one does with all.

    Its unit of time is one in which its time step is ``dt``, which a controller may have.
    """
    unit = dt / (every * esc.dt)
    return replace(
        esc,
        step_size=esc.step_size * every,
        dwell=esc.dwell * unit,
        tau_f=esc.tau_f * unit,
        rate_limit=esc.rate_limit / unit,
        dt=dt,
    )


def make_lifter(task: Task, c: Constants) -> LifterConfig:
    """Return the detector's configuration."""
    return LifterConfig(omega_h=rounded(c.omega_h), omega_l=rounded(c.omega_l), dt=task.dt)


def rounded(value: float) -> float:
    """Return a number of three digits, as it is written into the file.

    >>> rounded(0.0123456)
    0.0123
    """
    return float(f"{value:.3g}")


def try_out(task: Task, c: Constants, number: int, seed: int, fine: bool = True) -> Outcome:
    """Run once; ``number`` chooses surrogate and end of the range."""
    options = (task.surrogates if fine else task.coarse)[c.omega_h]
    s = options[(number // 2) % len(options)]
    rng = np.random.default_rng([seed, number])
    end = number % 2
    theta = task.scale.theta_at(float(end))
    every = round(s.dt / task.dt)
    steps = task.steps // every
    limit = task.settings.drift
    drift = 0.0 if number % 4 < 2 else float(rng.uniform(-limit, limit)) / steps
    esc = replace(make_esc(task, c, theta), epsilon_initial=1 if end else -1)
    detector = make_lifter(task, c).detector_params()
    if s.coarse:
        esc = slow_down(esc, every, task.settings.coarse_dt)
        detector = cost.detector_params(c.omega_h, c.omega_l, s.dt)._replace(alpha_hp=0.0)
    u, power = np.empty(BLOCKS), np.empty(BLOCKS)
    surrogate.run(
        s,
        detector,
        esc.params(),
        esc.initial(),
        steps,
        drift,
        float(end),
        rng.random(1021),
        u,
        power,
    )
    return outcome(task, s, u, power, steps * s.dt)


def outcome(
    task: Task, s: Surrogate, u: NDArray[np.float64], power: NDArray[np.float64], time: float
) -> Outcome:
    """Judge a run of a time [s]."""
    maps = task.sense * s.amplitudes
    i = int(np.argmin(maps))
    best, worst = float(maps[i]), float(maps.max())
    logs = 0.5 * task.sense * np.log(power) - best  # above 0, more or less
    half = BLOCKS // 2
    late = 0.5 * task.sense * math.log(float(power[half:].mean())) - best
    inside = np.flatnonzero(logs <= task.settings.convergence.bound(worst - best))
    share = (inside[0] + 1) / BLOCKS if inside.size else 2.0
    distance = float(np.abs(np.clip(u, 0.0, 1.0)[half:] - i / (s.amplitudes.size - 1)).mean())
    start = 0.5 * task.sense * math.log(float(power[0])) - best
    return Outcome(
        math.exp(late),
        share * time if inside.size else math.inf,
        distance,
        math.exp(start - late),
        u,
        power,
        late + task.settings.slowness * share,
    )


def draw(task: Task, count: int, seed: int) -> list[Constants]:
    """Return constants from all over the ranges."""
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
    """Return by how much a score must be better for constants that are not the usual ones."""
    usual = _in_units(task, c.law, c.omega_h, _usual(task))
    far = [math.log(getattr(c, name) / getattr(usual, name)) / math.log(3.0) for name in SEARCHED]
    return task.settings.unusual * sum(x * x for x in far)


@dataclass(frozen=True)
class Trial:
    """Constants and how they did.

    Attributes
    ----------
    constants : Constants
        What was tried.
    outcomes : list of Outcome
        Each run's.
    unusual : float
        See :func:`unusual`.
    percentile : float
        Percentile of the runs' scores that counts.
    """

    constants: Constants
    outcomes: list[Outcome]
    unusual: float
    percentile: float

    @property
    def score(self) -> float:
        """The percentile that counts."""
        return float(np.percentile([o.score for o in self.outcomes], self.percentile))

    @property
    def rank(self) -> float:
        """What the best has least of."""
        return self.score + self.unusual


def search(
    task: Task,
    effort: float,
    seed: int,
    report: Callable[[float], None] = lambda share: None,
    workers: int = 1,
) -> list[Trial]:
    """Return the best constants first, the better half of each round having run more often.

    Parameters
    ----------
    task : Task
        What is to be controlled.
    effort : float
        Search budget (1 = default).
    seed : int
        Seed of the draws.
    report : callable
        Is told of every run, as a share of all.
    workers : int
        Threads.
    """
    s = task.settings
    first = 2 ** max(round(math.log2(s.first * effort)), 3)
    rng = np.random.default_rng([seed, 7])
    total = 8 * first + 16 * s.top + 2 * len(list_anchors(task))

    with ThreadPoolExecutor(workers) as pool:

        def run_more(trials: list[Trial], upto: int) -> list[Trial]:
            def results(t: Trial) -> list[Outcome]:
                done = range(len(t.outcomes), upto)
                return [try_out(task, t.constants, n, seed, fine=False) for n in done]

            longer = []
            for t, outcomes in zip(trials, pool.map(results, trials), strict=True):
                report(len(outcomes) / total)
                longer.append(replace(t, outcomes=t.outcomes + outcomes))
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
    """Return the best constants, the best first, as they do sample by sample."""
    numbers = range(task.settings.fine_runs)
    confirmed = [
        replace(t, outcomes=[try_out(task, t.constants, n, seed) for n in numbers])
        for t in trials[: task.settings.fine]
    ]
    return sorted(confirmed, key=lambda t: t.rank)
