"""Settings of a tuning: each threshold with its range, meaning and origin."""

from __future__ import annotations

import math
from dataclasses import dataclass

from koop_core.config.parameter import Settings, judged, parameter
from koop_tune.origin import jsbsim, studied


@dataclass(frozen=True)
class Convergence(Settings):
    """When an amplitude counts as near its best."""

    good: float = studied(1.5, "amplitude over the best one", low=1.0)
    part: float = studied(
        0.25, "share of what theta can do above the best one, if less", low=0.0, high=1.0
    )

    def bound(self, span: float) -> float:
        """Return the logarithm of the amplitude over the best one that counts as converged.

        ``span`` belongs to the worst one.
        """
        return math.log(min(self.good, 1.0 + self.part * (math.exp(span) - 1.0)))


CONVERGENCE = Convergence()


@dataclass(frozen=True)
class SearchSettings(Settings):
    """The search on surrogates.

    The first five are least, usual and largest value in units of the rig's own: its time T and its
    range of theta.
    """

    omega_l: tuple[float, ...] = studied((0.5, 2.0, 10.0), "omega_l", unit="1/T")
    speed: tuple[float, ...] = studied((0.004, 0.08, 0.2), "speed of theta", unit="ranges/T")
    dwell: tuple[float, ...] = studied((0.4, 1.5, 8.0), "dwell time", unit="T")
    tau_f: tuple[float, ...] = studied((0.2, 0.7, 5.0), "tau_f", unit="T")
    step_ratio: tuple[float, ...] = studied((0.03, 0.15, 0.5), "step_ratio")
    speeds: tuple[float, ...] = studied((0.01, 0.03, 0.1), "always tried", unit="ranges/T")
    dwells: tuple[float, ...] = studied((1.0, 4.0), "always tried, with each speed", unit="T")
    unusual: float = studied(0.02, "score that a factor of 3 off the usual must gain", low=0.0)
    length: float = studied(80.0, "length of a run", unit="T", low=1.0)
    slowness: float = studied(0.15, "weight of the share of a run to converge", low=0.0)
    drift: float = studied(0.05, "motion of the optimum in a run at most, in ranges", low=0.0)
    percentile: float = studied(90.0, "percentile of the scores", unit="%", low=0.0, high=100.0)
    relays: float = studied(0.3, "share of the law relay in what is drawn", low=0.0, high=1.0)
    first: int = studied(64, "constants in the first round", low=8)
    top: int = studied(12, "constants of the last coarse round", low=1)
    fine: int = studied(3, "constants that are run sample by sample", low=1)
    fine_runs: int = studied(12, "runs of each of these", low=1)


SEARCH = SearchSettings()


@dataclass(frozen=True)
class TuningSettings(Settings):
    """Budget and thresholds of a tuning."""

    seed: int = parameter(0, "seed of all random numbers", low=0)
    effort: float = parameter(1.0, "search budget (1 = default)", low=1e-3, high=1e3)
    slowdown: float = parameter(1.0, "by which a loop showed the rig to be slower", low=1.0)
    workers: int = parameter(0, "threads of the search; 0: one for each processor", low=0)
    highpass: tuple[float, ...] = studied(
        (1.0, 3.0, 10.0, 30.0), "omega_h that are tried, over the oscillation's"
    )
    learned: int = parameter(65536, "samples that models are learned from", low=1024)
    slight: float = studied(0.1, "change of log amplitude that is treated as flat", low=0.0)
    near: float = studied(0.1, "distance of a cost's optimum from the amplitude's, in ranges")
    margin: float = jsbsim(0.06, "distance of theta from a cliff, in ranges", low=0.0)
    limits: float = studied(1.3, "amplitude over the best at the limits of theta", low=1.0)
    corner: float = judged(
        3.0, "amplitude over the best where several knobs are at their limits, at most", low=1.0
    )
    least_room: float = studied(0.005, "way beyond the best, in ranges", low=0.0)
    ahead: float = studied(4.0, "runs in which an optimum that moves has room", low=0.0)
    surrogates: int = studied(6, "rigs that are drawn from a recording", low=1)
    tau_spread: float = studied(0.35, "deviation of the logarithm of their times", low=0.0)
    blocks: int = studied(100, "blocks of a coarse surrogate in T", low=10)
    candidates: int = studied(2, "costs that are searched for, besides raw", low=1)
    longer: tuple[float, ...] = studied((1.0, 4.0, 16.0), "lengths of runs, until one is good")
    longest: float = parameter(
        2.0, "longest run, over the rig file's time", low=0.1, origin="no rig stays as it was"
    )
    as_good: float = studied(1.1, "score over the best of what is as good: raw, shorter", low=1.0)
    runs: int = studied(32, "runs of the prediction", low=8)
    y_out_max: float = parameter(10.0, "largest y_out, over the largest recorded", low=1.0)
    search: SearchSettings = SEARCH


TUNING = TuningSettings()


@dataclass(frozen=True)
class VerificationSettings(Settings):
    """How a closed loop is compared with its prediction."""

    smoothed: int = studied(3, "windows in whose mean an amplitude counts as converged", low=1)
    errors: float = studied(2.0, "standard errors that a band is widened by", low=0.0)
    sure: float = parameter(
        1.0, "standard errors by which an amplitude may be larger than measured", low=0.0,
        origin="one in six, at the limit",
    )  # fmt: skip
    seen: float = studied(3.0, "the same by which the best of all holds may be worse", low=0.0)
    seen_besides: float = studied(0.1, "log amplitude by which it may be worse besides", low=0.0)
    later: float = studied(1.2, "time to converge, over the band", low=1.0)
    least: float = studied(0.25, "time that a loop is closed, over the prediction's", low=0.0)
    twice: float = studied(2.0, "the same over the time to converge, if more", low=1.0)
    most_slower: float = studied(4.0, "slowdown that one round may show", low=1.0)
    before: int = judged(8, "windows at rest before the loop is closed, and after it", low=1)
    longer: float = judged(2.0, "factor by which a loop that may yet agree is prolonged", low=1.1)
    unknown: float = parameter(
        3.0, "error of a log amplitude of which too few windows tell one", low=0.0,
        origin="a factor of 20 either way: next to nothing is known",
    )  # fmt: skip
    rounds: int = studied(3, "rounds of tuning and verifying", low=1)
    broken: float = parameter(
        0.01, "share of a loop's second half in which a constraint may be broken", low=0.0,
        high=1.0, origin="the bound is to be kept for 99 % of the time",
    )  # fmt: skip


VERIFICATION = VerificationSettings()
