"""Settings of what is learned besides the modes: contrast and delays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from koop_core.config.parameter import parameter, validate

judged = partial(parameter, origin="judgement")


@dataclass(frozen=True)
class LearningSettings:
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

    def __post_init__(self) -> None:
        validate(self)


LEARNING = LearningSettings()
