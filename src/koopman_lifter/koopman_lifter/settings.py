"""Settings of the cost, of what is learned besides the modes, and of the watch."""

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


@dataclass(frozen=True)
class CostSettings(Settings):
    """When the cost is known."""

    bridged: int = judged(2, "lost samples that are interpolated", low=0)
    settled: float = parameter(
        3.0, "time constants after which a filter has settled", low=1.0, origin="to e^-3 = 5 %"
    )


LEARNING = LearningSettings()
WATCH, COST = constants(WatchSettings()), constants(CostSettings())
