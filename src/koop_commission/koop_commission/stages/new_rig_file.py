"""``koop commission --new``: asks for what a rig file holds, and proposes what the graph shows."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from koop_commission.fitness.arrivals import FEWEST, rhythm
from koop_commission.rig.listener import DISCOVERY, Ears, Samples, Topic, first_message, look, named
from koop_core.config.fields import Path as Field
from koop_core.config.fields import (
    check_fields,
    check_topic,
    check_type,
    format_field,
    numbers_of,
    parse_field,
    parse_source,
)
from koop_core.config.parameter import ConfigError, spec_of
from koop_node.client.alone import is_empty
from koop_node.process.domain import current_domain
from koop_tune.rig import rig_file
from koop_tune.rig.rig_file import RigFile

PATIENCE = 5.0  # [s] for a first message
LISTEN = 2.0  # [s] for rhythm and range of the channels
MARGIN = 3.0  # of the range seen, that a channel may leave it by
FEWEST_CHANNELS = 16  # more fields than that are not all proposed
OWN = ("/state", "/cost", "/theta", "/ground_truth")
Answer = TypeVar("Answer")
SPECS = {item.name: spec_of(item) for item in RigFile.__dataclass_fields__.values()}


def ask(path: Path) -> None:
    """Ask for a rig, and write its file.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If there is a file already, or no more answers.
    """
    if path.exists():
        raise ConfigError(f"{path} is there already: name another file")
    if not path.parent.is_dir():
        raise ConfigError(f"{path}: there is no folder {path.parent}")
    rig = asked(Dialogue())
    rig_file.write(rig, path)
    print(
        f"\nwritten to {path}; now: ./koop check {path}, or all that is to be done: "
        f"./koop commission {path}"
    )


class Dialogue:
    """Questions on the terminal, or to a pipe: a line each; an empty one takes the proposal."""

    def ask(
        self, question: str, proposal: str, take: Callable[[str], Answer], more: str = ""
    ) -> Answer:
        """Ask until the answer can be taken.

        Raises
        ------
        koop_core.config.parameter.ConfigError
            If there are no more answers, or one from a pipe cannot be taken.
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
                return take(line.strip() or proposal)
            except ValueError as error:
                if piped:
                    raise ConfigError(f"{question}: {error}; nothing was written") from None
                print(f"  {error}")


def asked(dialogue: Dialogue) -> RigFile:
    """Return the rig that the answers describe."""
    from koop_node.client.client import Client

    domain = current_domain()
    empty = is_empty(domain)
    if not empty:
        print(f"looking at ROS domain {domain} for {DISCOVERY:g} s", flush=True)
    with Client("koop_commission") as client:
        topics = [] if empty else look(client)
        values: dict[str, Any] = {}
        values |= _measured(dialogue, client, topics)
        source = parse_source(values["measured"])
        heard = _heard(client, source.topic, values["measured_type"], source.fields)
        values["dt"] = _number(dialogue, "dt", _dt(heard), "time between two messages [s]")
        values |= _command(dialogue, client, topics, source.topic)
    for name, question in (
        ("theta_min", "least theta that may be commanded"),
        ("theta_max", "largest theta that may be commanded"),
        ("theta_rate", "largest change of theta per second"),
        ("theta_start", "theta that the rig has before anybody commands it"),
        ("theta_safe", "theta that is safe, which is taken when anything ends"),
    ):
        proposal = f"{values['theta_start']:g}" if name == "theta_safe" else ""
        values[name] = _number(dialogue, name, proposal, question, values)
    names = list(map(format_field, source.fields))
    if heard is not None and heard.x.size:
        low, high = np.nanmin(heard.x, axis=0), np.nanmax(heard.x, axis=0)
        seen = ", ".join(
            f"{n} {a:.4g} to {b:.4g}" for n, a, b in zip(names, low, high, strict=True)
        )
        room = MARGIN * np.maximum(high - low, 1e-9)
        bounds = [_rounded(low - room), _rounded(high + room)]
    else:
        seen, bounds = "nothing was heard", ["", ""]
    for name, word, proposal in zip(
        ("channel_min", "channel_max"), ("least", "largest"), bounds, strict=True
    ):
        values[name] = dialogue.ask(
            f"{word} value of {', '.join(names)} at which all must stop; none for no limit",
            proposal or "none",
            lambda text: _numbers(text, len(names)),
            f"seen: {seen}" if name == "channel_min" else "",
        )
    values["objective"] = dialogue.ask("minimise or maximise the oscillation", "minimise", _goal)
    values["time"] = _number(
        dialogue, "time", "1800", "longest time that moving theta over its range may take [s]"
    )
    return RigFile(**values)


def _measured(dialogue: Dialogue, client: Any, topics: Sequence[Topic]) -> dict[str, Any]:
    speaking = [t for t in topics if t.publishers and t.name not in OWN[1:]]
    topic, kind = _topic(
        dialogue, "topic of the measured channels", speaking,
        "topics that somebody publishes" if speaking else
        "nobody publishes anything in this ROS domain: is the rig started?",
    )  # fmt: skip
    message = None
    if any(known.name == topic for known in speaking):
        message = first_message(client, topic, kind, PATIENCE)
    fields = tuple(numbers_of(message)) if message is not None else ()
    if message is None:
        print(f"no message on {topic} in {PATIENCE:g} s: the fields cannot be shown")
    elif not fields:
        raise ConfigError(f"{topic}: {kind} holds no numbers; nothing was written")

    def taken(text: str) -> str:
        source = parse_source(f"{topic}:{text}")
        if message is not None:
            _check_received(source.fields, message)
        return f"{topic}:{named(source.fields)}"

    moving = _moving(fields, _heard(client, topic, kind, fields) if fields else None)
    offered, others = moving or fields, len(fields) - len(moving)
    shown = f"numbers of a message{' that change' * bool(moving)}: {named(offered)}" * bool(fields)
    shown += f"; {others} others do not change" * bool(moving and others)
    question = "fields that are the measured channels, separated by commas"
    measured = dialogue.ask(question, named(offered[:FEWEST_CHANNELS]), taken, shown)
    return {"measured": measured, "measured_type": kind}


def _command(
    dialogue: Dialogue, client: Any, topics: Sequence[Topic], measured: str
) -> dict[str, Any]:
    from koop_node.node.managed import message_type

    listened = [t for t in topics if t.subscribers and t.name != measured]
    listened.sort(key=lambda t: (bool(t.publishers), t.name))  # what waits for somebody comes first
    topic, kind = _topic(
        dialogue, "topic that takes theta", listened,
        "topics that somebody listens to" if listened else "nobody listens to anything",
    )  # fmt: skip
    made = message_type(kind)()
    fields = [format_field(path) for path in numbers_of(made)]
    proposal = "theta" if "theta" in fields else fields[0] if fields else "data[0]"

    def taken(text: str) -> str:
        path = parse_field(text)
        check_fields((path,), made)
        return f"{topic}:{format_field(path)}"

    return {"command": dialogue.ask("field that is theta", proposal, taken), "command_type": kind}


def _topic(dialogue: Dialogue, question: str, known: Sequence[Topic], head: str) -> tuple[str, str]:
    """Ask for a topic by its number or name; of one that is not there, for its type too."""
    rows = [
        f"  {i} {t.name}  {t.type}" + f"  (commanded by {', '.join(t.publishers)})"
        * bool(t.publishers and "takes" in question)
        for i, t in enumerate(known, 1)
    ]  # fmt: skip

    def taken(text: str) -> str:
        if text.isdecimal():
            if not 1 <= int(text) <= len(known):
                raise ConfigError(f"{text}: from 1 to {len(known)}, or a topic's name")
            return known[int(text) - 1].name
        return "/" + check_topic(text).lstrip("/")

    proposal = "1" if known else ""
    name = dialogue.ask(question, proposal, taken, "\n".join(["", head, *rows]))
    kind = next((t.type for t in known if t.name == name), None)
    if kind is None:
        kind = dialogue.ask(f"message type of {name}, which is not there now", "", check_type)
    return name, kind


def _heard(client: Any, topic: str, kind: str, fields: Any) -> Samples | None:
    """Listen for a while; None if nothing comes."""
    ears = Ears(client, topic, kind, fields)
    deadline = time.monotonic() + LISTEN
    while time.monotonic() < deadline:
        client.spin(0.05)
    ears.close()
    return ears.samples() if ears.count else None


def _moving(fields: tuple[Field, ...], heard: Samples | None) -> tuple[Field, ...]:
    """Return the fields that are not one and the same number: covariances and the like are."""
    if heard is None:
        return ()
    columns = [x[np.isfinite(x)] for x in heard.x.T]
    return tuple(
        field for field, x in zip(fields, columns, strict=True) if x.size and np.ptp(x) > 0.0
    )


def _dt(heard: Samples | None) -> str:
    if heard is None or heard.arrival.size < FEWEST:
        return ""
    usual = float(np.median(np.diff(heard.arrival)))
    interval = rhythm(heard.arrival, heard.stamp, heard.step, max(usual, 1e-6)).interval
    return f"{interval:.3g}" if interval > 0.0 else ""


def _number(
    dialogue: Dialogue,
    name: str,
    proposal: str,
    question: str,
    known: dict[str, Any] | None = None,
) -> float:
    def taken(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            raise ConfigError(f"{text!r} is not a number") from None
        spec = SPECS[name]
        if not spec.low <= value <= spec.high:
            raise ConfigError(f"{value:g}: must be {spec.constraint}")
        low = (known or {}).get("theta_min", -math.inf)
        high = (known or {}).get("theta_max", math.inf)
        if name == "theta_max" and value <= low:
            raise ConfigError(f"{value:g}: must be above theta_min = {low:g}")
        if name in ("theta_start", "theta_safe") and not low <= value <= high:
            raise ConfigError(f"{value:g}: must lie within [{low:g}, {high:g}]")
        return value

    return dialogue.ask(question, proposal, taken)


def _numbers(text: str, count: int) -> tuple[float, ...]:
    if text == "none":
        return ()
    try:
        values = tuple(float(word) for word in text.replace(",", " ").split())
    except ValueError:
        raise ConfigError(f"{text!r} are not numbers") from None
    if len(values) != count:
        raise ConfigError(f"{len(values)} numbers, there are {count} channels")
    return values


def _goal(text: str) -> str:
    if text not in SPECS["objective"].choices:
        raise ConfigError(f"{text!r}: {SPECS['objective'].constraint}")
    return text


def _rounded(values: Any) -> str:
    return " ".join(f"{value:.3g}" for value in values)


def _check_received(fields: Any, message: Any) -> None:
    """Refuse fields that a message which came does not have."""
    from koop_core.config.fields import read_field

    check_fields(fields, message)
    for path in fields:
        if not isinstance(read_field(path, message), float) or (
            path[-1][1] is not None and np.isnan(read_field(path, message))
        ):
            raise ConfigError(f"'{format_field(path)}' is beyond the end of the message that came")
