"""When messages are late, stale or of another run, and when a finding about them is news."""

from __future__ import annotations

from dataclasses import dataclass

from koop_core.config.parameter import Settings, constants, judged, parameter


@dataclass(frozen=True)
class StreamSettings(Settings):
    """How the messages of a stream are judged."""

    window: int = parameter(
        64, "steps that a message may be late; further back is another run", low=1,
        origin="more than a network reorders, less than a run has at its restart",
    )  # fmt: skip
    silence: int = judged(20, "samples without a message after which an input is stale", low=1)
    shortest: float = parameter(
        0.5, "the same at least", unit="s", low=0.0, origin="pauses of a loaded machine"
    )
    period: float = judged(10.0, "unbroken arrivals that tell the clocks' difference", unit="s",
                           low=0.1)  # fmt: skip
    fall: float = judged(
        0.1, "fall of the delay from one period to the next while a link drains", unit="s", low=0.0
    )
    gap: float = judged(1.0, "between two arrivals after which the periods begin again", unit="s",
                        low=0.0)  # fmt: skip
    leaving: float = parameter(
        10.0, "silence after which a source that leaves was lost before", unit="s", low=0.0,
        origin="a node takes seconds to end on a busy machine; a killed one is counted for 20 s",
    )  # fmt: skip
    settled: float = judged(
        5.0, "that a less urgent finding must last before it is news", unit="s", low=0.0
    )


STREAM = constants(StreamSettings())
