"""Settings of how recordings are read and models of them learned."""

from __future__ import annotations

from dataclasses import dataclass

from koop_core.config.parameter import Settings, constants, judged, parameter


@dataclass(frozen=True)
class ReadingSettings(Settings):
    """From messages to samples one dt apart, and the candidates learned from them."""

    gaps: float = judged(3.0, "pause that is a gap, in usual periods or dt", low=1.0)
    stepped: float = judged(0.01, "share of dt that the time of a step may differ", low=0.0)
    finer: float = judged(100.0, "states interpolated between two samples, at most", low=1.0)
    even: float = judged(0.05, "the same, of the mean period of counted samples", low=0.0)
    long: float = judged(
        1.5, "wait after which a missing sample is looked for", unit="periods", low=1.0
    )
    sure: float = judged(0.75, "wait not made up for: a sample is missing", unit="periods", low=0.5)
    span: int = judged(1000, "samples over which the mean period is taken", low=1)
    least: int = judged(50, "samples looked at around a long wait, at least", low=1)
    most: int = parameter(
        10_000, "the same at most", low=1, origin="twice what a link that was cut holds"
    )
    stale: float = judged(10.0, "age of theta at which it is unknown, in usual intervals", low=1.0)
    stale_least: float = judged(1.0, "the same, at least", unit="s", low=0.0)
    delays: int = judged(8, "samples of the candidates with delays", low=2)
    part: int = judged(2048, "samples in a row where not all are learned from", low=2)


READING = constants(ReadingSettings())
