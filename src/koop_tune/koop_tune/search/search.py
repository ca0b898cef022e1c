"""The search for the constants of a controller on surrogates of the rig.

Constants are drawn by a Sobol sequence from ranges in units of the rig's own: its period, its time
T = tau + two periods, its range of theta. Each is judged by runs from both ends of the range, on
several surrogates, with the optimum at rest and in motion; the better half gets more runs
(successive halving; Jamieson and Talwalkar 2016), then the surroundings of the best are drawn from
once more. A run's score is

    log(amplitude over its second half / least amplitude) + SLOWNESS (share of the run to converge)

and a constant's score the 90th percentile over its runs. Of constants that score alike those are
taken that serve most rigs (USUAL): a surrogate is not the rig, and what is best on it by a hair may
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

from koop_tune.rig_model import surrogate
from koop_tune.rig_model.surrogate import BLOCKS, Surrogate
from koopman_lifter import cost
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
USUAL = {"omega_l": 2.0, "speed": 0.08, "dwell": 1.5, "tau_f": 0.7, "step_ratio": 0.15}
ANCHORS = {"speed": (0.01, 0.03, 0.1), "dwell": (1.0, 4.0)}  # that are tried beside those drawn
UNUSUAL = 0.02  # what a score must be better by for a constant that is a factor of 3 off the usual
LENGTH = 80.0  # of a run, in T
SLOWNESS = 0.15
DRIFT = 0.05  # of the range, by which the optimum moves in a run at most
PERCENTILE = 90.0
GOOD = 1.5  # times the least amplitude, and
PART = 0.25  # of what theta can do above it: whatever is less counts as converged
FIRST = 64  # constants in the first round
TOP, FINE = 12, 3  # constants of the last coarse round; of those that are run sample by sample
FINE_RUNS = 12  # of each of these
COARSE_DT = 0.01  # of a controller in blocks [s]


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
    surrogates, coarse : dict of float to list of Surrogate
        By omega_h [rad/s]: sample by sample, and in blocks.
    sense : float
        +1 to minimise.
    time : float
        T [s].
    dt : float
        Sampling time [s].
    rate : float
        Largest change of theta per second.
    low, high : float
        Limits of the controller's theta; inside those of the rig file, or these.
    """

    surrogates: dict[float, list[Surrogate]]
    coarse: dict[float, list[Surrogate]]
    sense: float
    time: float
    dt: float
    rate: float
    low: float
    high: float

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
        theta_min=task.low,
        theta_max=task.high,
        rate_limit=rate,
        objective="minimise" if task.sense > 0.0 else "maximise",
        theta_initial=theta,
        epsilon_initial=1,
        dt=task.dt,
    )


def slowed(esc: EscConfig, every: int) -> EscConfig:
    """Return a controller that does with one of ``every`` samples what this one does with all.

    In units of time in which its dt is one that a controller may have.
    """
    unit = COARSE_DT / (every * esc.dt)
    return replace(
        esc,
        step_size=esc.step_size * every,
        dwell=esc.dwell * unit,
        tau_f=esc.tau_f * unit,
        rate_limit=esc.rate_limit / unit,
        dt=COARSE_DT,
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
    task: Task, c: Constants, number: int, seed: int, start: float | None = None, fine: bool = True
) -> Outcome:
    """Run once; ``number`` chooses surrogate and end of the range."""
    options = (task.surrogates if fine else task.coarse)[c.omega_h]
    s = options[(number // 2) % len(options)]
    rng = np.random.default_rng([seed, number])
    end = float(number % 2) if start is None else start
    theta = s.low * (s.high / s.low) ** end if s.logarithmic else s.low + end * (s.high - s.low)
    every = round(s.dt / task.dt)
    steps = task.steps // every
    drift = 0.0 if number % 4 < 2 else float(rng.uniform(-DRIFT, DRIFT)) / steps
    esc = replace(esc_of(task, c, theta), epsilon_initial=1 if end > 0.5 else -1)
    detector = lifter_of(task, c).detector_params()
    if s.coarse:
        esc = slowed(esc, every)
        detector = cost.detector_params(c.omega_h, c.omega_l, s.dt)._replace(alpha_hp=0.0)
    u, power = np.empty(BLOCKS), np.empty(BLOCKS)
    surrogate.run(
        s, detector, esc.params(), esc.initial(), steps, drift, end, rng.random(1021), u, power
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
    bound = math.log(min(GOOD, 1.0 + PART * (math.exp(worst - best) - 1.0)))
    inside = np.flatnonzero(logs <= bound)
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
    task: Task,
    centres: Sequence[Constants],
    count: int,
    rng: np.random.Generator,
    spread: float,
) -> list[Constants]:
    """Return constants near some."""
    found = []
    for i in range(count):
        c = centres[i % len(centres)]
        own: dict[str, Any] = {
            name: getattr(c, name) * math.exp(rng.normal(0.0, spread)) for name in RANGES
        }
        own["step_ratio"] = min(max(own["step_ratio"], 0.01), 1.0)
        found.append(replace(c, **own))
    return found


def anchors(task: Task) -> list[Constants]:
    """Return constants that serve many rigs."""
    high = sorted(task.surrogates)
    omega_h = high[min(2, len(high) - 1)]
    return [
        _in_units(task, law, omega_h, {**USUAL, "speed": speed, "dwell": dwell})
        for law in ("relay", "adaptive")
        for speed in ANCHORS["speed"]
        for dwell in ANCHORS["dwell"]
    ]


def unusual(task: Task, c: Constants) -> float:
    """Return by how much a score must be better for constants that are not the usual ones."""
    usual = _in_units(task, c.law, c.omega_h, USUAL)
    far = [math.log(getattr(c, name) / getattr(usual, name)) / math.log(3.0) for name in USUAL]
    return UNUSUAL * sum(x * x for x in far)


@dataclass(frozen=True)
class Tried:
    """Constants and how they did.

    Attributes
    ----------
    constants : Constants
        What was tried.
    outcomes : list of Outcome
        Of each run.
    unusual : float
        See :func:`unusual`.
    """

    constants: Constants
    outcomes: list[Outcome]
    unusual: float

    @property
    def rank(self) -> float:
        """Return what the best has least of."""
        return self.score + self.unusual

    @property
    def score(self) -> float:
        """Return the score."""
        return score_of(self.outcomes)


def search(
    task: Task,
    effort: float,
    seed: int,
    said: Callable[[float], None] = lambda share: None,
    workers: int = 1,
) -> list[Tried]:
    """Return the best constants first, the better half of each round having run more often.

    Parameters
    ----------
    task : Task
        What is to be controlled.
    effort : float
        Of the search, in units of the usual one.
    seed : int
        Of the draws.
    said : callable
        Told of every run, as a share of all.
    workers : int
        Threads.
    """
    first = 2 ** max(round(math.log2(FIRST * effort)), 3)
    rng = np.random.default_rng([seed, 7])
    total = 8 * first + 16 * TOP + 2 * len(anchors(task))

    with ThreadPoolExecutor(workers) as pool:

        def more(tried: list[Tried], upto: int) -> list[Tried]:
            def results(t: Tried) -> list[Outcome]:
                done = range(len(t.outcomes), upto)
                return [try_out(task, t.constants, n, seed, fine=False) for n in done]

            found = []
            for t, outcomes in zip(tried, pool.map(results, tried), strict=True):
                said(len(outcomes) / total)
                found.append(replace(t, outcomes=t.outcomes + outcomes))
            return sorted(found, key=lambda t: t.rank)

        def new(constants: Sequence[Constants], runs: int) -> list[Tried]:
            return more([Tried(c, [], unusual(task, c)) for c in constants], runs)

        tried = new([*anchors(task), *draw(task, first, seed)], 2)
        tried = more(tried[: first // 4], 8)
        for spread in (0.35, 0.2):
            near = around(task, [t.constants for t in tried[:4]], first // 4, rng, spread)
            tried = sorted([*new(near, 8), *tried], key=lambda t: t.rank)
        return more(tried[:TOP], 24)


def confirm(task: Task, tried: Sequence[Tried], seed: int) -> list[Tried]:
    """Return the best constants, the best first, as they do sample by sample."""
    found = [
        replace(t, outcomes=[try_out(task, t.constants, n, seed) for n in range(FINE_RUNS)])
        for t in tried[:FINE]
    ]
    return sorted(found, key=lambda t: t.rank)
