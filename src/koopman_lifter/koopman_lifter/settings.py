"""Settings of the cost, of what is learned besides the modes, of the watch and after a change."""

from __future__ import annotations

from dataclasses import dataclass

from koop_core.config.parameter import Settings, constants, judged, parameter


@dataclass(frozen=True)
class LearningSettings(Settings):
    """Which windows are compared for a contrast, and what delays span."""

    quartile: float = judged(
        0.25, "share of the windows that is strong, and weak", low=0.01, high=0.5
    )
    transient: float = judged(0.2, "share of a trajectory without moments", low=0.0, high=0.9)
    bins: int = judged(6, "bins of theta, at most", low=2)
    in_a_bin: int = parameter(
        4, "windows of a bin, at least", low=4, origin="two to propose, two to judge"
    )
    ridge: float = judged(1e-9, "regularisation with delays, over the variance", low=0.0)
    monomials: int = judged(120, "monomials of a state with delays, at most", low=2)
    span: float = judged(0.125, "newest to oldest delay, in periods", low=0.01, high=1.0)


@dataclass(frozen=True)
class WatchSettings(Settings):
    """When the oscillation's frequency has changed, and how its usual range is learned."""

    listened: int = judged(
        4096, "samples, or means of several, in which the oscillation is looked for", low=640
    )
    known: int = judged(200, "windows that the known range is learned from", low=32)
    move: float = parameter(
        0.1, "change that is looked for, over the frequency", low=0.01, high=0.2, origin="demand"
    )
    averaged: int = judged(16, "windows of the running mean frequency", low=2)
    memory: int = judged(50, "windows of its variance and of the usual power", low=2)
    least: float = judged(0.005, "deviation of a frequency that is believed, at least", low=1e-6)
    new: float = judged(0.5, "information of a window that those before it lack", low=0.1, high=1.0)
    most: float = judged(0.6, "of the threshold, that one window may add", low=0.1, high=1.0)
    outshone: float = judged(
        10.0, "power of a line over what was there and is left, when it is the oscillation", low=2.0
    )
    spike: float = judged(
        100.0, "power of a window over the usual one, of which no more is learned", low=2.0
    )
    bang: float = judged(1e3, "the same, of a spectrum's line over the most", low=10.0)
    kept: float = judged(0.999, "of that most, after each spectrum", low=0.5, high=1.0)
    stayed: float = judged(
        0.5, "of the power of the oscillation's line that is left where it has not moved", low=0.0
    )


@dataclass(frozen=True)
class CandidateSettings(Settings):
    """From which samples another model is learned after a change, and when it is proposed."""

    periods: int = judged(
        600, "periods that are kept, for the controller to seek in meanwhile", low=64
    )
    most: int = judged(2**17, "samples that are kept, at most, if they are enough", low=1024)
    window: int = judged(8, "periods of a window", low=4)
    fewest: int = judged(16, "windows to learn from, and to judge by, at least", low=8)
    better: float = parameter(
        2.0, "standard errors of the rank correlation by which the candidate's is higher", low=0.0,
        origin="one in 44 where they are equal",
    )  # fmt: skip
    drowned: float = judged(
        0.5, "share of the cost's power at the oscillation's frequency, if less it has drowned",
        low=0.0, high=1.0,
    )  # fmt: skip
    purer: float = judged(
        10.0, "power at that frequency over the rest, of a candidate over a drowned cost's", low=1.0
    )
    worse: float = judged(
        1.2, "factor by which the oscillation grows under a model that is given back", low=1.0
    )


@dataclass(frozen=True)
class CostSettings(Settings):
    """When the cost is known."""

    bridged: int = judged(2, "lost samples that are interpolated", low=0)
    settled: float = parameter(
        3.0, "time constants after which a filter has settled", low=1.0, origin="to e^-3 = 5 %"
    )


LEARNING, CANDIDATE = LearningSettings(), CandidateSettings()
WATCH, COST = constants(WatchSettings()), constants(CostSettings())
