"""Configuration of the player."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from koop_bag.bag.topics import is_common
from koop_core.config.parameter import ConfigError, parameter, validate

PACES = ("realtime", "scaled", "fast", "lockstep")
CLOCKS = ("off", "receive", "stamp")
ANSWERED = ("cost", "theta")  # topics that the live loop publishes while it is played to


@dataclass(frozen=True)
class PlayerConfig:
    """What is played, how fast, and to whom.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If a value has the wrong type or is out of range.
    """

    bag: str = parameter("", "bag, folder of a run, or .mcap file", read_only=True)
    pace: str = parameter(
        "realtime",
        "realtime; scaled: realtime times the rate; fast: as fast as the subscribers accept it; "
        "lockstep: a message of `gate` goes out when `answer` for the last one came",
        choices=PACES,
        read_only=True,
    )
    rate: float = parameter(1.0, "bag seconds in a second, at scaled pace", low=1e-3, high=1e3)
    topics: str = parameter(
        "",
        "topics to play, separated by spaces, by their names in the bag; empty: all but those that "
        "every node publishes by itself (/rosout, /parameter_events, /diagnostics, /clock, "
        "transition_event) and, in lockstep, those that the live nodes answer with (cost, theta)",
        read_only=True,
    )
    remap: str = parameter(
        "", "other names for topics, each as from:=to, separated by spaces", read_only=True
    )
    start: float = parameter(
        0.0, "begin this long after the bag's begin", unit="s", low=0.0, read_only=True
    )
    duration: float = parameter(
        0.0, "play this much of the bag; 0: up to its end", unit="s", low=0.0, read_only=True
    )
    loop: bool = parameter(False, "begin again after the end")
    paused: bool = parameter(False, "begin paused", read_only=True)
    position: float = parameter(
        0.0, "set it to go to a time, counted from the bag's begin", unit="s", low=0.0
    )
    clock: str = parameter(
        "off",
        "publish /clock: receive: the time of each message in the bag, and at 200 Hz between them; "
        "stamp: that of each new header stamp, which is simulated time if the run had it",
        choices=CLOCKS,
        read_only=True,
    )
    wait_for: str = parameter(
        "",
        "topics that must have a subscriber before the first message goes out, each as name or "
        "name:count; empty: any topic, and in lockstep the gate; none: do not wait",
        read_only=True,
    )
    gate: str = parameter("state", "topic whose messages begin a step", read_only=True)
    answer: str = parameter("theta", "topic that ends a step, in lockstep", read_only=True)
    answer_timeout: float = parameter(
        2.0,
        "in lockstep, send the message again when the answer takes longer; the fourth time is an "
        "error",
        unit="s",
        low=0.01,
        high=3600.0,
        read_only=True,
    )

    def __post_init__(self) -> None:
        validate(self)
        parse_remap(self.remap)
        parse_counts(self.wait_for)

    @property
    def speed(self) -> float:
        """Bag seconds in a second."""
        return {"realtime": 1.0, "scaled": self.rate}.get(self.pace, math.inf)


def parse_remap(text: str) -> dict[str, str]:
    """Return new names by old ones.

    >>> parse_remap("/state:=/replayed/state")
    {'/state': '/replayed/state'}
    """
    names: dict[str, str] = {}
    for item in text.split():
        old, separator, new = item.partition(":=")
        if not (old and separator and new):
            raise ConfigError(f"remap: '{item}' is not from:=to")
        names[old] = new
    return names


def parse_counts(text: str) -> dict[str, int]:
    """Return numbers of subscribers by topic.

    >>> parse_counts("state:2 cost")
    {'state': 2, 'cost': 1}
    """
    counts: dict[str, int] = {}
    for item in text.split() if text != "none" else ():
        name, separator, count = item.partition(":")
        if not name or (separator and not count.isdigit()):
            raise ConfigError(f"wait_for: '{item}' is neither a name nor name:count")
        counts[name] = int(count or 1)
    return counts


def default_topics(present: Iterable[str], lockstep: bool) -> list[str]:
    """Return the topics of a bag that are played if none are chosen."""
    answers = ANSWERED if lockstep else ()
    return [
        name for name in present if not is_common(name) and name.rsplit("/", 1)[-1] not in answers
    ]
