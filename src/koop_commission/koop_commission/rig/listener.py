"""Collects the messages of one topic of a live rig, with their arrival."""

from __future__ import annotations

import math
import time
from array import array
from typing import Any

import numpy as np

from koop_commission.fitness.samples import Samples
from koop_core.config.fields import Path, check_fields, read_field
from koop_node.client.client import Client


class Listener:
    """Subscribes to one topic and keeps what it receives.

    Parameters
    ----------
    client : Client
        Observer in the ROS domain.
    topic, kind : str
        Name, and type ``pkg/msg/Type``.
    paths : sequence of Path
        The numbers that are taken out of each message.
    reliable : bool
        Whether lost messages are sent again; drivers often offer best effort only.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If the message type is not installed or has no such field.

    Attributes
    ----------
    last : object
        Newest message; None before the first.
    """

    def __init__(
        self, client: Client, topic: str, kind: str, paths: tuple[Path, ...], reliable: bool = False
    ) -> None:
        from koop_node.node.managed import message_type
        from koop_node.node.qos import BEST_EFFORT, RELIABLE

        message = message_type(kind)
        check_fields(paths, message())
        self._paths = paths
        self._arrival, self._stamp, self._x = array("d"), array("d"), array("d")
        self._step = array("q")
        self._newest = math.nan
        self.last: Any = None
        self._client = client
        self._subscription = client.node.create_subscription(
            message, topic, self._on_message, RELIABLE if reliable else BEST_EFFORT
        )

    @property
    def count(self) -> int:
        """Number of messages received."""
        return len(self._arrival)

    @property
    def age(self) -> float:
        """Time since the newest message [s]; NaN before the first."""
        return time.monotonic() - self._newest

    def close(self) -> None:
        """Unsubscribe."""
        self._client.node.destroy_subscription(self._subscription)

    def samples(self, begin: int = 0, end: int | None = None) -> Samples:
        """Return the samples from one message to before another."""
        end = self.count if end is None else end
        n, arrival = len(self._paths), np.array(self._arrival[begin:end])
        return Samples(
            arrival,
            np.array(self._stamp[begin:end]),
            np.array(self._step[begin:end]),
            np.array(self._x[begin * n : end * n]).reshape(arrival.size, n),
        )

    def _on_message(self, message: Any) -> None:
        self._newest = time.monotonic()
        self.last = message
        stamp: Any = getattr(getattr(message, "header", None), "stamp", None)
        seconds = stamp.sec + 1e-9 * stamp.nanosec if hasattr(stamp, "nanosec") else 0.0
        step = getattr(message, "step", -1)
        self._arrival.append(self._newest)
        self._stamp.append(seconds)
        self._step.append(step if isinstance(step, int) else -1)
        self._x.extend(read_field(path, message) for path in self._paths)


def listen(
    client: Client, topic: str, kind: str, paths: tuple[Path, ...], seconds: float
) -> Samples | None:
    """Listen to a topic for a time [s]; return the samples, None without a message."""
    listener = Listener(client, topic, kind, paths)
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        client.spin(0.05)
    listener.close()
    return listener.samples() if listener.count else None


def receive_one(client: Client, topic: str, kind: str, seconds: float) -> Any:
    """Return a message of a topic; None if none arrives within a time [s]."""
    listener = Listener(client, topic, kind, ())
    deadline = time.monotonic() + seconds
    while listener.last is None and time.monotonic() < deadline:
        client.spin(0.05)
    listener.close()
    return listener.last
