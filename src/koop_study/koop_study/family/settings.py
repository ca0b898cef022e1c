"""Settings that every family of rigs shares."""

from __future__ import annotations

from dataclasses import dataclass

from koop_core.config.parameter import Settings, constants, judged


@dataclass(frozen=True)
class FamilySettings(Settings):
    """How rigs are drawn, recorded and judged."""

    samples_low: int = judged(20, "samples of a period, at least", low=4)
    samples_high: int = judged(50, "samples of a period, at most", low=4)
    drowning: float = judged(100.0, "noise of a drowned rig over its oscillation, rms", low=1.0)
    slight_low: float = judged(1.1, "least depth of the other side of a one-sided map", low=1.0)
    slight_high: float = judged(1.3, "the same at most", low=1.0)
    lag: float = judged(0.3, "between channels, of an interference's period", low=0.0, high=1.0)
    slow: float = judged(100.0, "slowest tau in which an optimum drifts as in an hour", low=1.0)
    far: float = judged(0.25, "start to optimum at least, in u", low=0.0, high=0.5)
    alive: float = judged(0.03, "of L*, that is left of either of two modes", low=0.0, high=0.5)
    margin: float = judged(0.05, "that a moving optimum keeps from the ends, in u", low=0.0)
    blocks: int = judged(200, "blocks that a run is averaged in", low=2)
    longer: tuple[float, ...] = judged(
        (1.0, 2.0, 4.0), "times of the rig file that an engineer gives, one after the other"
    )
    periods: float = judged(10.0, "slowest periods that the rig file's time adds", low=0.0)
    often: float = judged(0.1, "of the samples, after which their number is judged again", low=0.01)
    good: float = judged(1.5, "amplitude over the best, of a converged loop", low=1.0)


FAMILY = constants(FamilySettings())
