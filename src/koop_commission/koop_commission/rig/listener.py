"""Listens to a live rig: who is there, and what the measured channels say, with their arrival."""

from __future__ import annotations

import math
import time
from array import array
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.config.fields import Path, check_fields, format_field, read_field
from koop_core.config.parameter import ConfigError
from koop_core.errors import LiveError
from koop_node.client.client import Client
from koop_tune.rig.rig_file import RigFile

DISCOVERY = 4.0  # [s]: Fast DDS, as it comes, announces itself every 3 s to who missed the first
HIDDEN = ("/rosout", "/parameter_events", "/diagnostics", "/clock", "/tf", "/tf_static")


class Topic(NamedTuple):
    """A topic of the graph.

    Attributes
    ----------
    name, type : str
        Full name; ``pkg/msg/Type``.
    publishers, subscribers : tuple of str
        The nodes, by their full names; one of another DDS has none.
    """

    name: str
    type: str
    publishers: tuple[str, ...]
    subscribers: tuple[str, ...]


class Samples(NamedTuple):
    """What was heard.

    Attributes
    ----------
    arrival : ndarray, shape (M,)
        When each message came [s].
    stamp : ndarray, shape (M,)
        Its stamp [s]; 0 where it has none.
    step : ndarray, shape (M,)
        Its step; -1 where it has none.
    x : ndarray, shape (M, n)
        The measured channels; NaN where the message has no such number.
    """

    arrival: NDArray[np.float64]
    stamp: NDArray[np.float64]
    step: NDArray[np.int64]
    x: NDArray[np.float64]


class Ears:
    """Collects the messages of one topic.

    Parameters
    ----------
    client : Client
        Guest in the ROS domain.
    topic, kind : str
        Where, and of which type ``pkg/msg/Type``.
    paths : sequence of Path
        The numbers that are taken out of each message.
    reliable : bool
        Whether what is lost is asked for again; drivers often offer best effort only.

    Raises
    ------
    ValueError
        If the message type is not installed or has no such field.
    """

    def __init__(
        self, client: Client, topic: str, kind: str, paths: tuple[Path, ...], reliable: bool = False
    ) -> None:
        from koop_node.node.managed import message_type
        from koop_node.node.qos import BEST_EFFORT, RELIABLE

        made = message_type(kind)
        check_fields(paths, made())
        self._paths = paths
        self._arrival, self._stamp, self._x = array("d"), array("d"), array("d")
        self._step = array("q")
        self._heard = math.nan
        self.last: Any = None
        self._client = client
        self._subscription = client.node.create_subscription(
            made, topic, self._on_message, RELIABLE if reliable else BEST_EFFORT
        )

    @property
    def count(self) -> int:
        """How many messages have come."""
        return len(self._arrival)

    @property
    def silent(self) -> float:
        """Time since the last message [s]; NaN before the first."""
        return time.monotonic() - self._heard

    def close(self) -> None:
        """Stop listening."""
        self._client.node.destroy_subscription(self._subscription)

    def samples(self, begin: int = 0, end: int | None = None) -> Samples:
        """Return what was heard, from one message to before another."""
        end = self.count if end is None else end
        n, arrival = len(self._paths), np.array(self._arrival[begin:end])
        return Samples(
            arrival,
            np.array(self._stamp[begin:end]),
            np.array(self._step[begin:end]),
            np.array(self._x[begin * n : end * n]).reshape(arrival.size, n),
        )

    def _on_message(self, message: Any) -> None:
        now = self._heard = time.monotonic()
        self.last = message
        stamp: Any = getattr(getattr(message, "header", None), "stamp", None)
        seconds = stamp.sec + 1e-9 * stamp.nanosec if hasattr(stamp, "nanosec") else 0.0
        step = getattr(message, "step", -1)
        self._arrival.append(now)
        self._stamp.append(seconds)
        self._step.append(step if isinstance(step, int) else -1)
        self._x.extend(read_field(path, message) for path in self._paths)


def refuse_dead(names: Sequence[str], x: NDArray[np.float64]) -> None:
    """Raise LiveError if one of the channels of samples, shape (M, n), says nothing."""
    for name, column in zip(names, x.T, strict=True):
        known = column[np.isfinite(column)]
        if not known.size:
            raise LiveError(f"{name} is not a number any more: dead sensor")
        if np.ptp(known) == 0.0:
            raise LiveError(f"{name} is {known[0]:g} and does not change: dead sensor")


def look(
    client: Client, until: Callable[[], object] = lambda: False, patience: float = DISCOVERY
) -> list[Topic]:
    """Return the topics that others speak or listen on, after the time that discovery takes.

    Parameters
    ----------
    client : Client
        Guest in the ROS domain.
    until : callable, optional
        Looks no longer once this is true.
    patience : float
        Time to look [s].
    """
    deadline = time.monotonic() + patience
    while time.monotonic() < deadline and not until():
        client.spin(0.05)
    found = []
    for name, kinds in client.node.get_topic_names_and_types():
        if name in HIDDEN or "/_" in name or name.endswith("/transition_event"):
            continue
        speak, listen = who(client, name)
        if speak or listen:
            found.append(Topic(name, kinds[0], speak, listen))
    return sorted(found)


def who(client: Client, topic: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the nodes of others that publish and that subscribe to a topic."""
    own = client.node.get_name()

    def names(infos: Any) -> tuple[str, ...]:
        known = (
            f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for info in infos
            if info.node_name != own
        )
        return tuple(UNKNOWN if "_NODE_NAME_UNKNOWN_" in n else n for n in known)

    return (
        names(client.node.get_publishers_info_by_topic(topic)),
        names(client.node.get_subscriptions_info_by_topic(topic)),
    )


def speakers(client: Client, topic: str) -> set[str]:
    """Return who publishes a topic, by an id that is another one once it was started again."""
    found = client.node.get_publishers_info_by_topic(topic)
    return {bytes(info.endpoint_gid).hex() for info in found}


UNKNOWN = "another program"
COMMANDER = "/koop_commander"
GIVEN_UP = 21.0  # [s] after which DDS takes one for gone that was killed


def who_else_commands(client: Client, topic: str, own: bool) -> list[str]:
    """Return the nodes of others that publish a topic.

    Parameters
    ----------
    own : bool
        Whether the commander of this process does, too; its name comes a little later than itself.
    """
    names = list(who(client, topic)[0])
    for name in (COMMANDER, UNKNOWN) if own else ():
        if name in names:
            names.remove(name)
            break
    return sorted(set(names))


def two_rigs(client: Client, rig: RigFile) -> str:
    """Say who publishes the measured topic if more than one does; else nothing."""
    names = who(client, rig.state.topic)[0]
    if len(names) < 2:
        return ""
    return f"{rig.state.topic} is published by {' and '.join(names)}: end all but the rig"


def refuse_two_rigs(client: Client, rig: RigFile) -> None:
    """Refuse a measured topic that more than one publish.

    One that was killed counts as there until DDS gives it up; that is waited for.

    Raises
    ------
    koop_core.errors.LiveError
        If there are still two after that time.
    """
    deadline = time.monotonic() + GIVEN_UP
    if text := two_rigs(client, rig):
        print(f"{text}; one that was killed is forgotten in {GIVEN_UP:g} s at most", flush=True)
    while text:
        if time.monotonic() > deadline:
            raise LiveError(text)
        client.spin(0.2)
        text = two_rigs(client, rig)


def refuse_wrong_names(
    client: Client,
    rig: RigFile,
    patience: float = DISCOVERY,
    check: Callable[[], object] = lambda: None,
) -> None:
    """Refuse a rig file that names what the live graph does not have, after some time [s].

    ``check`` is called meanwhile; it may raise LiveError.

    Raises
    ------
    koop_core.errors.LiveError
        If nobody speaks on the measured topic or listens to the command, or they speak another
        message type.
    koop_core.config.parameter.ConfigError
        If a type is not installed or has no such field.
    """
    from koop_node.node.managed import message_type

    sides = {
        "measured": (rig.state, rig.measured_type, 0),
        "command": (rig.knob, rig.command_type, 1),
    }
    for key, (source, kind, _) in sides.items():
        try:
            check_fields(source.fields, message_type(kind)())
        except ValueError as error:
            raise ConfigError(f"{key}: {error}") from None

    def there(topic: str, side: int) -> bool:
        return bool(who(client, topic)[side])

    def found() -> bool:
        check()
        return all(there(source.topic, side) for source, _, side in sides.values())

    topics = look(client, found, patience)
    for key, (source, kind, side) in sides.items():
        does, nobody = (("speaks", "publishes"), ("listens", "subscribes to"))[side]
        known = [topic for topic in topics if (topic.publishers, topic.subscribers)[side]]
        at = next((topic for topic in known if topic.name == source.topic), None)
        if at is None:
            others = ", ".join(f"{t.name} ({t.type})" for t in known[:8]) or "nothing"
            raise LiveError(
                f"{key}: nobody {nobody} {source.topic}: is the rig started, in this ROS domain? "
                f"Others are there for {others}"
            )
        kinds = dict(client.node.get_topic_names_and_types()).get(source.topic, [kind])
        if kind not in kinds:
            raise LiveError(f"{key}: {source.topic} {does} {kinds[0]}, the file says {kind}")


def first_message(client: Client, topic: str, kind: str, seconds: float) -> Any:
    """Return a message of a topic, or None if there is none in time."""
    ears = Ears(client, topic, kind, ())
    deadline = time.monotonic() + seconds
    while ears.last is None and time.monotonic() < deadline:
        client.spin(0.05)
    ears.close()
    return ears.last


def named(paths: tuple[Path, ...]) -> str:
    """Return fields as a rig file writes them."""
    return ",".join(map(format_field, paths))
