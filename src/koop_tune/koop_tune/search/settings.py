"""What decides a tuning: each threshold with its range, meaning and origin."""

from __future__ import annotations

import math
from dataclasses import dataclass

from koop_core.config.parameter import parameter, validate

STUDY = "study commission"  # random rigs, commissioned offline


@dataclass(frozen=True)
class Convergence:
    """When an amplitude counts as near its best."""

    good: float = parameter(1.5, "amplitude over the best one", low=1.0, origin=STUDY)
    part: float = parameter(
        0.25, "share of what theta can do above the best one, where that is less", low=0.0,
        high=1.0, origin=STUDY,
    )  # fmt: skip

    def __post_init__(self) -> None:
        validate(self)

    def bound(self, span: float) -> float:
        """Return the logarithm of the amplitude over the best one that counts as converged.

        ``span`` is that of the worst one.
        """
        return math.log(min(self.good, 1.0 + self.part * (math.exp(span) - 1.0)))


CONVERGENCE = Convergence()


@dataclass(frozen=True)
class SearchSettings:
    """The search on surrogates.

    Ranges of constants are least, usual and largest value in units of the rig's own: its time T and
    its range of theta.
    """

    omega_l: tuple[float, ...] = parameter((0.5, 2.0, 10.0), "omega_l", unit="1/T", origin=STUDY)
    speed: tuple[float, ...] = parameter(
        (0.004, 0.08, 0.2), "speed of theta", unit="ranges/T", origin=STUDY
    )
    dwell: tuple[float, ...] = parameter((0.4, 1.5, 8.0), "dwell time", unit="T", origin=STUDY)
    tau_f: tuple[float, ...] = parameter((0.2, 0.7, 5.0), "tau_f", unit="T", origin=STUDY)
    step_ratio: tuple[float, ...] = parameter((0.03, 0.15, 0.5), "step ratio", origin=STUDY)
    speeds: tuple[float, ...] = parameter(
        (0.01, 0.03, 0.1), "speeds that are tried besides those drawn", unit="ranges/T",
        origin=STUDY,
    )  # fmt: skip
    dwells: tuple[float, ...] = parameter(
        (1.0, 4.0), "dwell times that are tried besides those drawn", unit="T", origin=STUDY
    )
    unusual: float = parameter(
        0.02, "by how much the score must be better for a constant a factor of 3 off the usual",
        low=0.0, origin=STUDY,
    )  # fmt: skip
    length: float = parameter(80.0, "length of a run", unit="T", low=1.0, origin=STUDY)
    slowness: float = parameter(
        0.15, "weight of the share of the run to converge", low=0.0, origin=STUDY
    )
    drift: float = parameter(
        0.05, "motion of the optimum in a run at most, in ranges", low=0.0, high=1.0, origin=STUDY
    )
    percentile: float = parameter(
        90.0, "percentile of the runs' scores that counts", low=0.0, high=100.0, origin=STUDY
    )
    relays: float = parameter(0.3, "share of the relay in what is drawn", low=0.0, high=1.0)
    first: int = parameter(64, "constants in the first round", low=8, origin=STUDY)
    top: int = parameter(12, "constants of the last coarse round", low=1, origin=STUDY)
    fine: int = parameter(3, "constants that are run sample by sample", low=1, origin=STUDY)
    fine_runs: int = parameter(12, "runs of each of these", low=1, origin=STUDY)
    coarse_dt: float = parameter(
        0.01, "time step of a controller in blocks", unit="s", low=1e-6, high=1.0
    )
    convergence: Convergence = CONVERGENCE

    def __post_init__(self) -> None:
        validate(self)


SEARCH = SearchSettings()


@dataclass(frozen=True)
class TuningSettings:
    """Budget of a tuning, and everything that it decides with."""

    seed: int = parameter(0, "seed of all random numbers", low=0)
    effort: float = parameter(1.0, "search budget (1 = default)", low=1e-3, high=1e3)
    slowdown: float = parameter(
        1.0, "factor by which a closed loop showed the rig to be slower than its rests do", low=1.0
    )
    workers: int = parameter(0, "threads of the search; 0: one for each processor", low=0)
    periods: float = parameter(
        4.0, "length of a window, in periods of the oscillation", low=1.0, origin=STUDY
    )
    highpass: tuple[float, ...] = parameter(
        (1.0, 3.0, 10.0, 30.0), "omega_h that are tried, over the oscillation's", origin=STUDY
    )
    learned: int = parameter(
        65536, "samples that models are learned from, spread over the recording", low=1024
    )
    slight: float = parameter(
        0.1, "change of the logarithm of the amplitude that is treated as flat", low=0.0,
        origin=STUDY,
    )  # fmt: skip
    clearer: float = parameter(
        2.0, "clarity of a contrast's map over the amplitude's, from which on it decides", low=1.0,
        origin=STUDY,
    )  # fmt: skip
    decides: float = parameter(
        3.0, "evidence of a cost that decides where the amplitude's leaves doubt, over the usual",
        low=1.0, origin=STUDY,
    )  # fmt: skip
    near: float = parameter(
        0.2, "distance of a cost's optimum from the amplitude's, in ranges", low=0.0, high=1.0,
        origin=STUDY,
    )  # fmt: skip
    cliff_width: float = parameter(
        0.08, "width of a cliff, in ranges; a wider one is not known well", low=0.0, high=1.0,
        origin="JSBSim's aircraft",
    )  # fmt: skip
    margin: float = parameter(
        0.06, "distance of theta from the last good value before a cliff, in ranges", low=0.0,
        high=1.0, origin="JSBSim's aircraft",
    )  # fmt: skip
    room: float = parameter(
        0.1, "way beyond the outermost good value, in ranges, for an optimum that moves", low=0.0,
        high=1.0, origin=STUDY,
    )  # fmt: skip
    doubt: float = parameter(
        2.0, "standard errors by which a value may be better than it was measured", low=0.0
    )
    surrogates: int = parameter(6, "rigs that are drawn from a recording", low=1, origin=STUDY)
    tau_spread: float = parameter(
        0.35, "standard deviation of the logarithm of their time constants", low=0.0, origin=STUDY
    )
    blocks: int = parameter(100, "blocks of a coarse surrogate in T at least", low=10)
    candidates: int = parameter(2, "costs that are searched for, besides raw", low=1, origin=STUDY)
    longer: tuple[float, ...] = parameter(
        (1.0, 4.0, 16.0), "lengths of a run that are tried until the best is good", origin=STUDY
    )
    longest: float = parameter(
        2.0, "longest run, over the rig file's time for the excitation", low=0.1,
        origin="no rig stays as it was for longer",
    )  # fmt: skip
    as_good: float = parameter(
        1.1, "score at which raw, or a short run, is as good as the best", low=1.0, origin=STUDY
    )
    runs: int = parameter(32, "runs of the prediction", low=8, origin=STUDY)
    y_out_max: float = parameter(
        10.0, "largest y_out that is believed, over the largest recorded", low=1.0
    )
    search: SearchSettings = SEARCH

    def __post_init__(self) -> None:
        validate(self)


TUNING = TuningSettings()
