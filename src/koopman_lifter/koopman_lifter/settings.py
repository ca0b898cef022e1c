"""Settings of what is learned besides the modes: contrast, delays and a run under way."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from koop_core.config.parameter import Settings, parameter

judged = partial(parameter, origin="judgement")


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
    span: float = judged(0.125, "newest to oldest delay, in periods", low=0.01, high=1.0)


@dataclass(frozen=True)
class RunningSettings(Settings):
    """How the sums of a run under way forget."""

    alertness: float = judged(
        0.01, "least gain of a direction over its loss: to follow a weaker oscillation", low=1e-6
    )
    quiet: float = judged(
        1e-4, "gain of a block about its mean, over its share, that says nothing", low=0.0
    )
    ridge: float = judged(1e-12, "regularisation, over the variance", low=0.0)


LEARNING = LearningSettings()
RUNNING = RunningSettings()
