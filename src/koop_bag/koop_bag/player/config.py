"""Configuration of the player."""

from __future__ import annotations

import math
from dataclasses import dataclass

from koop_core.config.parameter import ConfigError, Settings, parameter

FAST, REALTIME = "fast", "realtime"


@dataclass(frozen=True)
class PlayerConfig(Settings):
    """Configuration of a playback."""

    bag: str = parameter("", "bag, folder of a run, or .mcap file", read_only=True)
    pace: str = parameter(
        REALTIME,
        "realtime; a number: so many times realtime; fast: as fast as the subscribers accept",
        read_only=True,
    )
    topics: str = parameter(
        "",
        "topics to play, separated by spaces, by their names in the bag; empty: all but those that "
        "every node publishes by itself (/rosout, /parameter_events, /diagnostics, /clock, "
        "transition_event)",
        read_only=True,
    )
    start: float = parameter(
        0.0,
        "time of the bag, from its begin, at which the playback starts",
        unit="s",
        low=0.0,
        read_only=True,
    )
    clock: bool = parameter(
        False, "publish /clock: the time of each message in the bag", read_only=True
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.speed

    @property
    def speed(self) -> float:
        """Bag seconds in a second; infinite: without a pace."""
        if self.pace == FAST:
            return math.inf
        try:
            speed = 1.0 if self.pace == REALTIME else float(self.pace)
        except ValueError:
            speed = math.nan
        if not 1e-3 <= speed <= 1e3:
            raise ConfigError(
                f"pace: '{self.pace}' is not realtime, fast or a number from 0.001 to 1000"
            )
        return speed
