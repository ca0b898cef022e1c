"""The search for the constants of a controller on surrogates of the rig.

Constants are drawn by a Sobol sequence from ranges in units of the rig's own: its period, its time
T = tau + two periods, its range of theta. Each is judged by runs from both ends of the range, on
several surrogates, with the optimum at rest and in motion; the better half gets more runs
(successive halving; Jamieson and Talwalkar 2016), then the surroundings of the best are drawn from
once more. A run's score is

    log(amplitude over its second half / least amplitude) + SLOWNESS (share of the run to converge)

and a constant's score the 90th percentile over its runs.
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

from koop_lab.tune import surrogate
from koop_lab.tune.stays import Scale
from koop_lab.tune.surrogate import BLOCKS, Surrogate
from koopman_lifter.config import LifterConfig
from relay_esc.config import EscConfig

HIGH = (1.0, 3.0, 10.0, 30.0)  # omega_h in units of the oscillation's frequency
RANGES = {  # of what else is searched; omega_l in 1/T, speed in ranges of theta per T, times in T
    "omega_l": (0.5, 10.0),
    "speed": (0.004, 0.2),
    "dwell": (0.4, 8.0),
    "tau_f": (0.2, 5.0),
    "step_ratio": (0.03, 0.5),
}
LENGTH = 80.0  # of a run, in T
SLOWNESS = 0.15
DRIFT = 0.05  # of the range, by which the optimum moves in a run at most
PERCENTILE = 90.0
GOOD = 1.5  # times the least amplitude, and
PART = 0.25  # of what theta can do above it: whatever is less counts as converged
WORKERS = 2
FEWEST, MOST = 16, 256  # constants in the first round


@dataclass(frozen=True)
class Constants:
    """What is searched, in SI units.

    Attributes
    ----------
    law : str
        relay or adaptive.
    omega_h, omega_l : float
        Of the detector [rad/s].
    speed : float
        Of theta, in ranges of u a second.
    dwell, tau_f : float
        [s].
    step_ratio : float
        Of the adaptive law.
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
    surrogates : dict of float to list of Surrogate
        By omega_h [rad/s].
    sense : float
        +1 to minimise.
    time : float
        T [s].
    dt : float
        Sampling time [s].
    rate : float
        Largest change of theta per second.
    """

    surrogates: dict[float, list[Surrogate]]
    sense: float
    time: float
    dt: float
    rate: float

    @property
    def any(self) -> Surrogate:
        """Return one of the surrogates."""
        return next(iter(self.surrogates.values()))[0]

    @property
    def steps(self) -> int:
        """Of a run."""
        s = self.any
        return round(LENGTH * max(self.time, 0.2 * (s.high - s.low) / self.rate) / self.dt)


@dataclass(frozen=True)
class Outcome:
    """What one run came to.

    Attributes
    ----------
    excess : float
        Amplitude over the second half over the best one, at least about 1.
    converged : float
        When [s]; infinite if never.
    distance : float
        Mean of abs(u - u*) over the second half.
    reduction : float
        Amplitude at the start over that of the second half.
    u, power : ndarray, shape (BLOCKS,)
        Where theta was, and the mean square of the amplitude.
    score : float
        See above.
    """

    excess: float
    converged: float
    distance: float
    reduction: float
    u: NDArray[np.float64]
    power: NDArray[np.float64]
    score: float


def esc_of(task: Task, c: Constants, theta: float) -> EscConfig:
    """Return the controller's configuration with theta at the start."""
    s = task.any
    step = c.speed * task.dt
    rate = task.rate
    if s.logarithmic:
        step *= math.log(s.high / s.low)
        rate /= s.high  # of theta at its largest
    else:
        step *= s.high - s.low
    return EscConfig(
        law=c.law,
        theta_scale="log" if s.logarithmic else "linear",
        step_size=min(rounded(step), rate * task.dt),
        step_ratio=rounded(c.step_ratio),
        dwell=rounded(c.dwell),
        tau_f=rounded(c.tau_f),
        theta_min=s.low,
        theta_max=s.high,
        rate_limit=rate,
        objective="minimise" if task.sense > 0.0 else "maximise",
        theta_initial=theta,
        epsilon_initial=1,
        dt=task.dt,
    )


def lifter_of(task: Task, c: Constants) -> LifterConfig:
    """Return the detector's configuration."""
    return LifterConfig(omega_h=rounded(c.omega_h), omega_l=rounded(c.omega_l), dt=task.dt)


def rounded(value: float) -> float:
    """Return a number of three digits, as it is written into the file.

    >>> rounded(0.0123456)
    0.0123
    """
    return float(f"{value:.3g}")


def try_out(
    task: Task, c: Constants, number: int, seed: int, start: float | None = None
) -> Outcome:
    """Run once; ``number`` chooses surrogate and end of the range."""
    options = task.surrogates[c.omega_h]
    s = options[(number // 2) % len(options)]
    rng = np.random.default_rng([seed, number])
    end = float(number % 2) if start is None else start
    theta = min(max(Scale(s.low, s.high).theta_at(end), s.low), s.high)
    steps = task.steps
    drift = 0.0 if number % 4 < 2 else float(rng.uniform(-DRIFT, DRIFT)) / steps
    esc = replace(esc_of(task, c, theta), epsilon_initial=1 if end > 0.5 else -1)
    u, power = np.empty(BLOCKS), np.empty(BLOCKS)
    surrogate.run(
        s, lifter_of(task, c).detector_params(), esc.params(), esc.initial(), steps, drift,
        rng.random(1021), u, power,
    )  # fmt: skip
    return outcome(task, s, u, power, steps)


def outcome(
    task: Task, s: Surrogate, u: NDArray[np.float64], power: NDArray[np.float64], steps: int
) -> Outcome:
    """Judge a run."""
    maps = task.sense * s.amplitudes
    i = int(np.argmin(maps))
    best, worst = float(maps[i]), float(maps.max())
    logs = 0.5 * task.sense * np.log(power) - best  # above 0, more or less
    half = BLOCKS // 2
    late = 0.5 * task.sense * math.log(float(power[half:].mean())) - best
    bound = math.log(min(GOOD, 1.0 + PART * (math.exp(worst - best) - 1.0)))
    inside = np.flatnonzero(logs <= bound)
    share = (inside[0] + 1) / BLOCKS if inside.size else 2.0
    time = steps * task.dt
    distance = float(np.abs(np.clip(u, 0.0, 1.0)[half:] - i / (s.amplitudes.size - 1)).mean())
    start = 0.5 * task.sense * math.log(float(power[0])) - best
    return Outcome(
        math.exp(late),
        share * time if inside.size else math.inf,
        distance,
        math.exp(start - late),
        u,
        power,
        late + SLOWNESS * share,
    )


def score_of(outcomes: Sequence[Outcome]) -> float:
    """Return the percentile that counts."""
    return float(np.percentile([o.score for o in outcomes], PERCENTILE))


def draw(task: Task, count: int, seed: int) -> list[Constants]:
    """Return constants from all over the ranges."""
    high = sorted(task.surrogates)
    points = qmc.Sobol(len(RANGES) + 2, seed=seed).random(count)
    found = []
    for point in points:
        values = {
            name: low * (top / low) ** x
            for (name, (low, top)), x in zip(RANGES.items(), point, strict=False)
        }
        omega_h = high[min(int(point[-2] * len(high)), len(high) - 1)]
        law = "relay" if point[-1] < 0.3 else "adaptive"
        found.append(_in_units(task, law, omega_h, values))
    return found


def _in_units(task: Task, law: str, omega_h: float, v: dict[str, float]) -> Constants:
    t, s = task.time, task.any
    # the rate may allow less than the fastest
    limit = task.rate / (s.high * math.log(s.high / s.low) if s.logarithmic else s.high - s.low)
    return Constants(
        law, omega_h, v["omega_l"] / t, min(v["speed"] / t, limit), v["dwell"] * t, v["tau_f"] * t,
        v["step_ratio"],
    )  # fmt: skip


def around(
    task: Task, centres: Sequence[Constants], count: int, rng: np.random.Generator
) -> list[Constants]:
    """Return constants near some."""
    found = []
    for i in range(count):
        c = centres[i % len(centres)]
        own: dict[str, Any] = {
            name: getattr(c, name) * math.exp(rng.normal(0.0, 0.35)) for name in RANGES
        }
        own["step_ratio"] = min(max(own["step_ratio"], 0.01), 1.0)
        found.append(replace(c, **own))
    return found


@dataclass(frozen=True)
class Tried:
    """Constants and how they did."""

    constants: Constants
    outcomes: list[Outcome]

    @property
    def score(self) -> float:
        """Return the score."""
        return score_of(self.outcomes)


def search(
    task: Task, steps: float, seed: int, said: Callable[[float], None] = lambda share: None
) -> list[Tried]:
    """Return the best constants first, the better half of each round having run more often.

    Parameters
    ----------
    task : Task
        What is to be controlled.
    steps : float
        That may be run in all.
    seed : int
        Of the draws.
    said : callable
        Told of every run, as a share of all.
    """
    per_run = task.steps
    runs = max(int(steps / per_run), 200)
    first = 2 ** int(math.log2(max(FEWEST, min(MOST, runs // 8))))  # an eighth, with two runs each
    rng = np.random.default_rng([seed, 7])
    with ThreadPoolExecutor(WORKERS) as pool:

        def more(tried: list[Tried], upto: int) -> list[Tried]:
            jobs = [
                [pool.submit(try_out, task, t.constants, n, seed)
                 for n in range(len(t.outcomes), upto)]
                for t in tried
            ]  # fmt: skip
            found = []
            for t, own in zip(tried, jobs, strict=True):
                results = [job.result() for job in own]
                said(len(results) / total)
                found.append(Tried(t.constants, t.outcomes + results))
            return sorted(found, key=lambda t: t.score)

        quarter, few = max(first // 4, 4), max(first // 16, 4)
        total = 2 * first + 6 * quarter + 4 * (first // 2) + 4 * few + 16 * 8 + 32 * 3
        tried = more([Tried(c, []) for c in draw(task, first, seed)], 2)
        tried = more(tried[:quarter], 8)
        near = around(task, [t.constants for t in tried[:4]], first // 2, rng)
        new = more([Tried(c, []) for c in near], 4)
        both = sorted([*more(new[:few], 8), *tried[:8]], key=lambda t: t.score)
        tried = more(both[:8], 24)
        return more(tried[:3], 56)
