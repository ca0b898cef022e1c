"""``koop commission --new``: asks for the content of a rig file, with proposals from the graph."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from itertools import compress, starmap
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from koop_commission.fitness.arrivals import measure_rhythm
from koop_commission.fitness.samples import Samples
from koop_commission.fitness.settings import DEFAULTS
from koop_commission.rig.graph import Topic, find_topics
from koop_commission.rig.listener import listen
from koop_core.config.fields import Path as Field
from koop_core.config.fields import (
    check_fields,
    check_topic,
    format_field,
    numbers_of,
    parse_source,
    parse_sources,
    read_field,
)
from koop_core.config.knobs import MOST
from koop_core.config.parameter import ConfigError, Settings, judged, spec_of
from koop_node.client.alone import DISCOVERY, is_empty
from koop_node.client.client import Client
from koop_node.process.domain import current_domain
from koop_tune.rig import rig_file
from koop_tune.rig.rig_file import RigFile

CONTROLLER_TOPICS = ("/cost", "/theta", "/ground_truth")
FAR = 1e300  # a limit of theta that was not asked for yet
SPECS = {item.name: spec_of(item) for item in fields(RigFile)}
Answer = TypeVar("Answer")


@dataclass(frozen=True)
class ProposalSettings(Settings):
    """How long messages are heard, and what is proposed of them."""

    patience: float = judged(5.0, "wait for a first message", unit="s", low=0.1)
    listen: float = judged(2.0, "for rate and range of the channels", unit="s", low=0.1)
    margin: float = judged(3.0, "ranges seen, by which a channel may leave that range", low=0.0)
    time: float = judged(1800.0, "of an excitation; each further knob twice", unit="s", low=1.0)
    most: int = judged(16, "fields that are proposed", low=1)
    pace: float = judged(1.5, "times real time that are asked about", low=1.0)


PROPOSAL = ProposalSettings()


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
        samples = self._ask_measured()
        self._ask("dt", proposal=_propose_dt(samples))
        if (pace := self._measure_pace(samples)) > PROPOSAL.pace:
            more = (
                f"a message every {self.values['dt'] / pace:.2g} s here: is it simulated, faster?"
            )
            self._ask("pace", proposal=f"{pace:.2g}", more=more)
        self._ask_command()
        for name in ("theta_min", "theta_max", "theta_rate", "theta_start"):
            self._ask(name)
        start = self.values["theta_start"]
        starts = start if isinstance(start, tuple) else [start]
        proposal = " ".join(f"{v:g}" for v in starts)
        self._ask("theta_safe", proposal=proposal)
        self._ask_limits(samples)
        objective = SPECS["objective"]
        self._ask("objective", f"{objective.description} ({objective.constraint})", "minimise")
        self._ask("time", proposal=f"{PROPOSAL.time * (2 * len(starts) - 1):g}")
        return RigFile(**self.values)

    def _ask_measured(self) -> Samples | None:
        """Ask for the measured channels; return their samples, if any were received."""
        published = [t for t in self.topics if t.publishers and t.name not in CONTROLLER_TOPICS]
        head = "published topics" if published else "no topic is published: is the rig running?"
        ((topic, kind),) = _ask_topics("topic of the measured channels", published, head)
        message = (
            listen(self.client, topic, kind, (), PROPOSAL.patience, most=1).last if kind else None
        )
        numbers = changing = tuple(numbers_of(message)) if message is not None else ()
        if message is None:
            print(f"no message on {topic}: the fields cannot be shown")
        elif not numbers:
            raise ConfigError(f"{topic}: {kind} holds no numbers; nothing was written")
        else:
            x = listen(self.client, topic, kind, numbers, PROPOSAL.listen).samples().x
            changing = tuple(compress(numbers, np.ptp(x, axis=0) > 0.0)) if x.size else ()
        offered, rest = changing or numbers, len(numbers) - len(changing)
        shown = f"numbers in a message{' that change' * bool(changing)}: {_join(offered)}"
        shown += f"; {rest} others do not change" * bool(changing and rest)

        def parse(text: str) -> str:
            source = parse_source(f"{topic}:{text}")
            if message is not None:
                check_fields(source.fields, message)
                for path in source.fields:
                    if path[-1][1] is not None and math.isnan(read_field(path, message)):
                        raise ConfigError(f"'{format_field(path)}' is beyond the end of a message")
            return f"{topic}:{_join(source.fields)}"

        question = "fields of the measured channels, separated by commas"
        proposal = _join(offered[: PROPOSAL.most])
        measured = ask(question, proposal, parse, shown * bool(numbers))
        self.values["measured"] = measured
        if not numbers:
            return None
        listener = listen(self.client, topic, kind, parse_source(measured).fields, PROPOSAL.listen)
        return listener.samples() if listener.count else None

    def _ask_command(self) -> None:
        measured = parse_source(self.values["measured"]).topic
        subscribed = [t for t in self.topics if t.subscribers and t.name != measured]
        subscribed.sort(key=lambda t: (bool(t.publishers), t.name))  # without a publisher first
        head = "topics with a subscriber" if subscribed else "no topic has a subscriber"
        head += " (name several, separated by commas, for several knobs)" * (len(subscribed) > 1)
        topics = _ask_topics("topic that takes theta", subscribed, head, MOST)
        command = ", ".join(starmap(self._ask_fields, topics))
        RigFile(**{**self.values, "command": command})  # refused if it names a knob twice
        self.values["command"] = command

    def _ask_fields(self, topic: str, kind: str) -> str:
        from koop_node.node.managed import message_type

        message = message_type(kind)() if kind else None
        names = [format_field(path) for path in numbers_of(message)] if message else ["data"]

        def parse(text: str) -> str:
            paths = parse_source(f"{topic}:{text}").fields
            if message is not None:
                check_fields(paths, message)
            return f"{topic}:{_join(paths)}"

        proposal = [*names, "data[0]"][0]
        if hasattr(message, "theta"):
            proposal = "theta" if "theta" in names else "theta[0]"
        several = " (of several knobs: separated by commas)" * (len(names) > 1)
        return ask(f"field of {topic} that takes theta{several}", proposal, parse)

    def _measure_pace(self, samples: Samples | None) -> float:
        if samples is None or samples.arrival.size < DEFAULTS.fewest:
            return 1.0
        dt = self.values["dt"]
        return float(dt * measure_rhythm(samples, dt).rate)

    def _ask_limits(self, samples: Samples | None) -> None:
        channels = parse_source(self.values["measured"]).fields
        proposals, seen = ["none", "none"], "seen: no message"
        if samples is not None:
            least, most = np.nanmin(samples.x, axis=0), np.nanmax(samples.x, axis=0)
            ranges = zip(map(format_field, channels), least, most, strict=True)
            seen = "seen: " + ", ".join(f"{n} {a:.6g} to {b:.6g}" for n, a, b in ranges)
            proposals = propose_limits(least, most)
            seen += (
                "; none proposed: a channel stands still, as one that follows theta does at rest"
                if "none" in proposals
                else "; at another theta they may swing far wider, and a channel that follows "
                "theta needs its range"
            )
        for name, word, proposal in zip(
            ("channel_min", "channel_max"), ("least", "largest"), proposals, strict=True
        ):
            question = f"{word} value of {_join(channels)}, beyond it theta returns; none: no limit"
            self._ask(name, question, proposal, seen * (name == "channel_min"))

    def _ask(self, name: str, question: str = "", proposal: str = "", more: str = "") -> None:
        spec, knobs = SPECS[name], 1
        if spec.per_knob:
            knobs = sum(len(source.fields) for source in parse_sources(self.values["command"]))
        question = question or f"{spec.description}{f' [{spec.unit}]' * bool(spec.unit)}"
        question += f", one number or {knobs}" * (knobs > 1)
        self.values[name] = ask(question, proposal, partial(self.parse, name), more)

    def parse(self, name: str, text: str) -> Any:
        """Return the answer for a key of the rig file, given those before.

        Raises
        ------
        koop_core.config.parameter.ConfigError
            If a rig file with it would be refused.
        """
        value: Any = text if name == "objective" else parse_numbers(text)
        if not name.startswith("channel") and len(value) == 1:
            (value,) = value
        values = {"command": "/not/asked/yet:x", **self.values, name: value}
        low = values.get("theta_min", -FAR)
        RigFile(**{"theta_min": low, "theta_max": FAR, "theta_start": low, "theta_safe": low,
                   **values})  # fmt: skip
        return value


def parse_numbers(text: str) -> tuple[float, ...]:
    """Return numbers that are separated by spaces or commas; ``none`` are none."""
    numbers = []
    for word in [] if text == "none" else text.replace(",", " ").split() or [text]:
        try:
            numbers.append(float(word))
        except ValueError:
            raise ConfigError(f"{word!r} is not a number") from None
    return tuple(numbers)


def _ask_topics(
    question: str, topics: Sequence[Topic], head: str, most: int = 1
) -> list[tuple[str, str]]:
    """Ask for topics by number or name; return them with their types, empty if not there."""

    def parse_one(text: str) -> str:
        if not text.isdecimal():
            return "/" + check_topic(text).lstrip("/")
        if not 1 <= int(text) <= len(topics):
            raise ConfigError(f"{text}: must be 1 to {len(topics)}, or the name of a topic")
        return topics[int(text) - 1].name

    def parse(text: str) -> list[str]:
        names = list(map(parse_one, text.replace(",", " ").split() or [text]))
        if len(set(names)) < len(names) or len(names) > most:
            raise ConfigError(f"{text}: name one topic" + f", or up to {most}" * (most > 1))
        return names

    rows = [
        f"  {number} {t.name}  {t.type}  (published by {', '.join(t.publishers) or 'none'})"
        for number, t in enumerate(topics, 1)
    ]
    only = "1" if len(topics) == 1 else ""  # of several none: it would be moved, wrong or not
    names = ask(question, only, parse, "\n".join(["", head, *rows]))
    types = {topic.name: topic.type for topic in topics}
    return [(name, types.get(name, "")) for name in names]


def _propose_dt(samples: Samples | None) -> str:
    if samples is None or samples.arrival.size < DEFAULTS.fewest:
        return ""
    usual = float(np.median(np.diff(samples.arrival)))
    interval = measure_rhythm(samples, max(usual, 1e-6)).interval
    return f"{interval:.3g}" if interval > 0.0 else ""


def propose_limits(least: NDArray[np.float64], most: NDArray[np.float64]) -> list[str]:
    """Return least and largest values of the channels, to three digits of the room they leave.

    There are none if a channel stands still: it may follow theta, and shows no range at rest.
    """
    seen = most - least
    if not (seen > 0.0).all():
        return ["none", "none"]
    room = PROPOSAL.margin * seen
    digits = 2 - np.floor(np.log10(room)).astype(int)
    return [
        " ".join(f"{round(v, n):.15g}" for v, n in zip(x.tolist(), digits.tolist(), strict=True))
        for x in (least - room, most + room)
    ]


def _join(paths: Sequence[Field]) -> str:
    return ",".join(map(format_field, paths))
