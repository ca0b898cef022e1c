"""One run of the loop on a surrogate: the constants that are tried, the rig, and the outcome."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from koop_tune.rig.scale import Scale
from koop_tune.rig_model import surrogate
from koop_tune.rig_model.surrogate import BLOCKS, Surrogate
from koop_tune.search.settings import CONVERGENCE, SEARCH, SearchSettings
from koopman_lifter import cost
from koopman_lifter.config import LifterConfig
from relay_esc.config import EscConfig


@dataclass(frozen=True)
class Constants:
    """Constants that are searched, in SI units.

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
    speed : float
        Of the optimum's motion [ranges/s].
    widest : tuple of float
        Least and largest theta to which the limits open where the optimum is lost; empty: none.
    slope, edge : float
        Change of a constraint's margin over the controller's u, and where it is 0; 0: none.
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
    speed: float = 0.0
    widest: tuple[float, ...] = ()
    slope: float = 0.0
    edge: float = 0.0

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
    """Outcome of one run.

    Attributes
    ----------
    excess : float
        Amplitude over the second half over the best one, at least about 1.
    converged : float
        Time to converge [s]; infinite if never.
    distance : float
        Mean of abs(u - u*) over the second half.
    reduction : float
        Amplitude at the start over the amplitude in the second half.
    u, power : ndarray, shape (BLOCKS,)
        Where theta was, and the mean square of the amplitude.
    score : float
        log(excess) + slowness (share of the run to converge); the least is the best.
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
        step_size=min(round_digits(c.speed * task.dt * task.scale.span), rate * task.dt),
        step_ratio=round_digits(c.step_ratio),
        dwell=round_digits(c.dwell),
        tau_f=round_digits(c.tau_f),
        theta_min=task.low,
        theta_max=task.high,
        widest=task.widest if c.law == "adaptive" else (),
        rate_limit=rate,
        objective="minimise" if task.sense > 0.0 else "maximise",
        theta_initial=theta,
        margin_slope=task.slope,
    )


def make_lifter(task: Task, c: Constants) -> LifterConfig:
    """Return the detector's configuration."""
    return LifterConfig(
        omega_h=round_digits(c.omega_h), omega_l=round_digits(c.omega_l), dt=task.dt
    )


def round_digits(value: float) -> float:
    """Return a number of three digits, as it is written into the file.

    >>> round_digits(0.0123456)
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
    low, high = task.scale.u(np.array([task.low, task.high]))
    limit = min(task.settings.drift, 0.5 * float(high - low))  # beyond the limits it is seen
    drift = 0.0 if number % 4 < 2 else float(rng.uniform(-limit, limit)) / steps
    drift += task.speed * s.dt
    esc = make_esc(task, c, theta)
    detector = make_lifter(task, c).detector_params()
    if s.coarse:
        esc = replace(esc, step_size=esc.step_size * every)  # the same motion of theta
        detector = cost.detector_params(c.omega_h, c.omega_l, s.dt)._replace(alpha_hp=0.0)
    u, power = np.empty(BLOCKS), np.empty(BLOCKS)
    surrogate.run(
        s,
        detector,
        esc.params(s.dt),
        esc.initial(),
        steps,
        drift,
        float(end),
        rng.random(1021),
        u,
        power,
        esc.barrier(s.dt),
        task.edge,
    )
    return judge_run(task, s, u, power, steps * s.dt, float(end))


def judge_run(
    task: Task, s: Surrogate, u: NDArray[np.float64], power: NDArray[np.float64], time: float,
    begin: float,
) -> Outcome:  # fmt: skip
    """Judge a run of a time [s], of a rig that had settled at a position."""
    maps = task.sense * s.amplitudes
    low, high = task.scale.u(np.array([task.low, task.high])) * (maps.size - 1)
    first = math.ceil(low)
    i = first + int(np.argmin(maps[first : math.floor(high) + 1]))
    best, worst = float(maps[i]), float(maps.max())
    logs = 0.5 * task.sense * np.log(power) - best  # above 0, more or less
    half = BLOCKS // 2
    late = 0.5 * task.sense * math.log(float(power[half:].mean())) - best
    inside = np.flatnonzero(logs <= CONVERGENCE.bound(worst - best))
    share = (inside[0] + 1) / BLOCKS if inside.size else 2.0
    distance = float(np.abs(np.clip(u, 0.0, 1.0)[half:] - i / (s.amplitudes.size - 1)).mean())
    start = float(np.interp(begin, np.linspace(0.0, 1.0, maps.size), maps)) - best
    return Outcome(
        math.exp(late),
        share * time if inside.size else math.inf,
        distance,
        math.exp(start - late),
        u,
        power,
        late + task.settings.slowness * share,
    )
