"""``koop commission --new``: asks for the content of a rig file, with proposals from the graph."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from koop_commission.fitness.arrivals import measure_rhythm
from koop_commission.fitness.samples import Samples
from koop_commission.fitness.settings import DEFAULTS
from koop_commission.rig.graph import DISCOVERY, Topic, find_topics
from koop_commission.rig.listener import listen, receive_one
from koop_core.config.fields import Path as Field
from koop_core.config.fields import (
    check_fields,
    check_topic,
    check_type,
    format_field,
    numbers_of,
    parse_field,
    parse_source,
    read_field,
)
from koop_core.config.parameter import ConfigError, spec_of
from koop_node.client.alone import is_empty
from koop_node.client.client import Client
from koop_node.process.domain import current_domain
from koop_tune.rig import rig_file
from koop_tune.rig.rig_file import RigFile

PATIENCE = 5.0  # [s] for a first message
LISTEN = 2.0  # [s] for rate and range of the channels
MARGIN = 3.0  # ranges seen, by which a channel may leave that range
MOST_CHANNELS = 16  # fields that are proposed
CONTROLLER_TOPICS = ("/cost", "/theta", "/ground_truth")
SPECS = {item.name: spec_of(item) for item in fields(RigFile)}
Answer = TypeVar("Answer")


def ask_for_rig(path: Path) -> None:
    """Ask for a rig, and write its file.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If the file exists already, or there are no more answers.
    """
    if path.exists():
        raise ConfigError(f"{path} exists already: name another file")
    if not path.parent.is_dir():
        raise ConfigError(f"{path}: there is no folder {path.parent}")
    domain = current_domain()
    empty = is_empty(domain)
    if not empty:
        print(f"looking at ROS domain {domain} for {DISCOVERY:g} s", flush=True)
    with Client("koop_commission") as client:
        rig = Interview(client, [] if empty else find_topics(client)).run()
    rig_file.write(rig, path)
    print(
        f"\nwritten to {path}; next: ./koop check {path}, or all stages at once: "
        f"./koop commission {path}"
    )


def ask(question: str, proposal: str, parse: Callable[[str], Answer], more: str = "") -> Answer:
    """Ask on the terminal, or a pipe, until the answer is valid; an empty line is the proposal.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If there are no more answers, or one from a pipe is not valid.
    """
    if more:
        print(more)
    while True:
        print(f"{question}{f' [{proposal}]' if proposal else ''}: ", end="", flush=True)
        line = sys.stdin.readline()
        if not line:
            print()
            raise ConfigError(f"no more answers at '{question}': nothing was written")
        piped = not sys.stdin.isatty()
        if piped:
            print(line.strip() or proposal)
        try:
            return parse(line.strip() or proposal)
        except ConfigError as error:
            if piped:
                raise ConfigError(f"{question}: {error}; nothing was written") from None
            print(f"  {error}")


@dataclass
class Interview:
    """Questions about one rig, on a graph with some topics; ``values`` are the answers so far."""

    client: Client
    topics: Sequence[Topic]
    values: dict[str, Any] = field(default_factory=dict)

    def run(self) -> RigFile:
        """Ask for every value of the rig file."""
        values = self.values
        self._ask_measured()
        source = parse_source(values["measured"])
        samples = listen(self.client, source.topic, values["measured_type"], source.fields, LISTEN)
        self._ask_number("dt", "time between two messages [s]", _propose_dt(samples))
        self._ask_command(source.topic)
        self._ask_number("theta_min", "least theta that may be commanded")
        self._ask_number("theta_max", "largest theta that may be commanded")
        self._ask_number("theta_rate", "largest change of theta per second")
        self._ask_number("theta_start", "theta of the rig before any command")
        self._ask_number(
            "theta_safe", "safe theta, to which every command returns", f"{values['theta_start']:g}"
        )
        self._ask_limits(list(map(format_field, source.fields)), samples)
        values["objective"] = ask("minimise or maximise the oscillation", "minimise", _parse_goal)
        self._ask_number("time", "longest time for moving theta over its range [s]", "1800")
        return RigFile(**values)

    def _ask_measured(self) -> None:
        published = [t for t in self.topics if t.publishers and t.name not in CONTROLLER_TOPICS]
        head = (
            "published topics" if published else
            "no topic is published in this ROS domain: is the rig running?"
        )  # fmt: skip
        topic, kind = _ask_topic("topic of the measured channels", published, head)
        message = None
        if topic in [t.name for t in published]:
            message = receive_one(self.client, topic, kind, PATIENCE)
        numbers = tuple(numbers_of(message)) if message is not None else ()
        if message is None:
            print(f"no message on {topic} in {PATIENCE:g} s: the fields cannot be shown")
        elif not numbers:
            raise ConfigError(f"{topic}: {kind} holds no numbers; nothing was written")

        def parse(text: str) -> str:
            source = parse_source(f"{topic}:{text}")
            if message is not None:
                _refuse_missing(source.fields, message)
            return f"{topic}:{_join(source.fields)}"

        samples = listen(self.client, topic, kind, numbers, LISTEN) if numbers else None
        changing = _find_changing(numbers, samples)
        offered, rest = changing or numbers, len(numbers) - len(changing)
        shown = f"numbers in a message{' that change' * bool(changing)}: {_join(offered)}"
        shown += f"; {rest} others do not change" * bool(changing and rest)
        self.values["measured"] = ask(
            "fields of the measured channels, separated by commas",
            _join(offered[:MOST_CHANNELS]), parse, shown * bool(numbers),
        )  # fmt: skip
        self.values["measured_type"] = kind

    def _ask_command(self, measured: str) -> None:
        from koop_node.node.managed import message_type

        subscribed = [t for t in self.topics if t.subscribers and t.name != measured]
        subscribed.sort(key=lambda t: (bool(t.publishers), t.name))  # without a publisher first
        head = "topics with a subscriber" if subscribed else "no topic has a subscriber"
        topic, kind = _ask_topic("topic that takes theta", subscribed, head, commanded=True)
        message = message_type(kind)()
        names = [format_field(path) for path in numbers_of(message)]
        proposal = "theta" if "theta" in names else names[0] if names else "data[0]"

        def parse(text: str) -> str:
            path = parse_field(text)
            check_fields((path,), message)
            return f"{topic}:{format_field(path)}"

        self.values["command"] = ask("field that takes theta", proposal, parse)
        self.values["command_type"] = kind

    def _ask_limits(self, names: Sequence[str], samples: Samples | None) -> None:
        low = high = "none"
        seen = "seen: no message"
        if samples is not None:
            least, most = np.nanmin(samples.x, axis=0), np.nanmax(samples.x, axis=0)
            ranges = zip(names, least, most, strict=True)
            seen = "seen: " + ", ".join(f"{n} {a:.4g} to {b:.4g}" for n, a, b in ranges)
            room = MARGIN * np.maximum(most - least, 1e-9)
            low, high = (" ".join(f"{v:.3g}" for v in x) for x in (least - room, most + room))
        channels = ", ".join(names)
        for key, word, proposal in (
            ("channel_min", "least", low),
            ("channel_max", "largest", high),
        ):
            question = f"{word} value of {channels} at which theta returns; none for no limit"
            parse = partial(_parse_numbers, count=len(names))
            self.values[key] = ask(question, proposal, parse, seen)
            seen = ""

    def _ask_number(self, name: str, question: str, proposal: str = "") -> None:
        self.values[name] = ask(question, proposal, partial(parse_number, name, self.values))


def parse_number(name: str, values: dict[str, Any], text: str) -> float:
    """Return the number of a rig file's key, given the values asked for before.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If it is not a number, out of range, or contradicts a value before.
    """
    try:
        value = float(text)
    except ValueError:
        raise ConfigError(f"{text!r} is not a number") from None
    spec = SPECS[name]
    if not spec.low <= value <= spec.high:
        raise ConfigError(f"{value:g}: must be {spec.constraint or 'finite'}")
    low, high = values.get("theta_min", -math.inf), values.get("theta_max", math.inf)
    if name == "theta_max" and value <= low:
        raise ConfigError(f"{value:g}: must be above theta_min = {low:g}")
    if name in ("theta_start", "theta_safe") and not low <= value <= high:
        raise ConfigError(f"{value:g}: must lie within [{low:g}, {high:g}]")
    return value


def _ask_topic(
    question: str, topics: Sequence[Topic], head: str, commanded: bool = False
) -> tuple[str, str]:
    """Ask for a topic by its number or name, and for the type of one that is not there."""

    def describe(number: int, topic: Topic) -> str:
        others = f"  (commanded by {', '.join(topic.publishers)})"
        return (
            f"  {number} {topic.name}  {topic.type}{others * bool(commanded and topic.publishers)}"
        )

    def parse(text: str) -> str:
        if not text.isdecimal():
            return "/" + check_topic(text).lstrip("/")
        if not 1 <= int(text) <= len(topics):
            raise ConfigError(f"{text}: must be 1 to {len(topics)}, or the name of a topic")
        return topics[int(text) - 1].name

    rows = [describe(number, topic) for number, topic in enumerate(topics, 1)]
    name = ask(question, "1" if topics else "", parse, "\n".join(["", head, *rows]))
    kind = next((topic.type for topic in topics if topic.name == name), None)
    if kind is None:
        kind = ask(f"message type of {name}, which does not exist now", "", check_type)
    return name, kind


def _find_changing(numbers: tuple[Field, ...], samples: Samples | None) -> tuple[Field, ...]:
    """Return the fields whose value changes; covariances and the like do not."""
    if samples is None:
        return ()
    columns = [x[np.isfinite(x)] for x in samples.x.T]
    return tuple(
        path for path, x in zip(numbers, columns, strict=True) if x.size and np.ptp(x) > 0.0
    )


def _propose_dt(samples: Samples | None) -> str:
    if samples is None or samples.arrival.size < DEFAULTS.fewest:
        return ""
    usual = float(np.median(np.diff(samples.arrival)))
    interval = measure_rhythm(samples, max(usual, 1e-6)).interval
    return f"{interval:.3g}" if interval > 0.0 else ""


def _parse_numbers(text: str, count: int) -> tuple[float, ...]:
    if text == "none":
        return ()
    try:
        values = tuple(float(word) for word in text.replace(",", " ").split())
    except ValueError:
        raise ConfigError(f"{text!r} is not a list of numbers") from None
    if len(values) != count:
        raise ConfigError(f"{len(values)} numbers for {count} channels")
    return values


def _parse_goal(text: str) -> str:
    if text not in SPECS["objective"].choices:
        raise ConfigError(f"{text!r}: must be {SPECS['objective'].constraint}")
    return text


def _refuse_missing(paths: Sequence[Field], message: Any) -> None:
    """Refuse fields that a message which was received does not have."""
    check_fields(tuple(paths), message)
    for path in paths:
        value = read_field(path, message)
        if not isinstance(value, float) or (path[-1][1] is not None and math.isnan(value)):
            raise ConfigError(f"'{format_field(path)}' is beyond the end of the message received")


def _join(paths: Sequence[Field]) -> str:
    return ",".join(map(format_field, paths))
