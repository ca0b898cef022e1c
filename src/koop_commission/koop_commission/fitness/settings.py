"""Settings that decide whether a rig is fit to be commissioned. Pure: no ROS."""

from __future__ import annotations

from dataclasses import dataclass

from koop_core.config.parameter import Settings, judged, parameter


@dataclass(frozen=True)
class CheckSettings(Settings):
    """Thresholds and times of ``koop check``."""

    listen: float = judged(5.0, "shortest time to listen before theta moves", unit="s", low=0.1)
    longest: float = judged(60.0, "longest time to listen before theta moves", unit="s", low=0.1)
    periods: float = parameter(
        10.0, "periods of the strongest oscillation to listen for", low=1.0,
        origin="resolves a line of the spectrum to a tenth of its frequency",
    )  # fmt: skip
    settle: float = judged(3.0, "periods at the start of a block that are left out", low=0.0)
    observe: float = judged(6.0, "periods of a block that are compared", low=1.0)
    late: float = judged(
        0.5, "least time that is left out of a block, for messages that come late", unit="s",
        low=0.0
    )  # fmt: skip
    step: float = judged(0.25, "share of its range by which theta moves", low=0.01, high=0.5)
    blocks: int = judged(8, "blocks after which a reaction is judged first", low=4, high=12)
    p: float = parameter(
        0.03, "chance of such a difference without a reaction, below which it is one then",
        low=0.0, high=1.0, origin="with p_more, one in twenty in all",
    )  # fmt: skip
    more: int = judged(6, "blocks that are added where the first ones do not decide", low=2, high=8)
    p_more: float = parameter(
        0.02, "that chance with them, and in longer blocks", low=0.0, high=1.0,
        origin="with p, one in twenty in all",
    )  # fmt: skip
    longer: tuple[float, ...] = parameter(
        (4.0, 12.0), "factors for the length of blocks where nothing reacts", low=1.0,
        origin="the strongest line, which sets the length, may be an interference",
    )  # fmt: skip
    longer_blocks: int = judged(10, "number of longer blocks", low=4, high=12)
    fewest: int = judged(20, "messages needed to judge their arrival", low=3, high=1000)
    near: float = judged(
        0.2, "share of dt by which the usual interval may differ from it", low=0.0, high=0.5
    )
    rise: float = parameter(
        0.6, "periods by which a lost message sets back all that follow, at least", low=0.5,
        high=1.0, origin="above a half, which jitter reaches, below the whole period of a loss",
    )  # fmt: skip
    slow: float = judged(0.02, "share by which the rate may differ from 1/dt", low=0.0, high=1.0)
    lost: float = judged(0.001, "share of lost messages that is noted", low=0.0, high=1.0)
    lost_badly: float = judged(0.05, "share of lost messages that is refused", low=0.0, high=1.0)
    coarse: float = parameter(
        0.2, "standard deviations of a channel that one step of its values may have", low=0.0,
        origin="a uniform error of 0.2 adds a 300th to the variance",
    )  # fmt: skip
    blind: float = judged(
        64.0, "samples that count as a period where the spectrum shows none", low=2.0
    )
    bands: int = judged(6, "bands of a channel's spectrum that blocks are compared in", low=1)
    power: float = judged(
        0.999, "share of a channel's power that these bands hold", low=0.5, high=1.0
    )
    silence: float = judged(
        30.0, "longest time for which nobody commands theta, in the test of a time-out", unit="s",
        low=1.0
    )  # fmt: skip
    known: int = judged(4, "blocks at either theta that tell the two apart in that test", low=2)
    apart: float = judged(3.0, "standard deviations by which they must differ", low=1.0)
    lucky: float = parameter(
        0.05, "variance, of all that a feature has, that is added to what it has at one theta",
        low=0.0, origin="few blocks show too little of it now and then",
    )  # fmt: skip
    stuck: float = judged(
        0.5, "share of the time that a channel may rest at one value", low=0.0, high=1.0
    )

    @property
    def series(self) -> tuple[tuple[float, tuple[tuple[int, float], ...]], ...]:
        """Factors for the length of blocks, each with stages: blocks, and the p that decides."""
        longer = ((self.longer_blocks, self.p_more), (self.more, self.p_more))
        first = ((self.blocks, self.p), (self.more, self.p_more))
        return ((1.0, first), *((factor, longer) for factor in self.longer))


DEFAULTS = CheckSettings()
