"""Collects the messages of one topic of a live rig, with their arrival."""

from __future__ import annotations

import math
import time
from array import array
from typing import Any

import numpy as np

from koop_commission.fitness.samples import Samples
from koop_core.config.fields import Path, Source, read_field
from koop_node.client.client import Client
from koop_node.node.stamps import to_seconds


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
    source, kind : Source, str
        Topic with fields, and message type.
    last : object
        Newest message; None before the first.
    """

    def __init__(
        self, client: Client, topic: str, kind: str, paths: tuple[Path, ...], reliable: bool = False
    ) -> None:
        from koop_node.node.managed import message_type
        from koop_node.node.qos import BEST_EFFORT, RELIABLE

        message = message_type(kind, paths)
        self.source, self.kind = Source(topic, paths), kind
        self._arrival, self._stamp, self._x = array("d"), array("d"), array("d")
        self._step = array("q")
        self.last: Any = None
        self._client = client
        self._subscription = client.node.create_subscription(
            message, topic, self._on_message, RELIABLE if reliable else BEST_EFFORT
        )

    @property
    def count(self) -> int:
        """Number of messages received."""
        return len(self._arrival)

    def count_steps(self, begin: int) -> int:
        """Return how many steps the rig made since a message: those received, and those lost."""
        received = self.count - begin
        if received <= 0:
            return 0
        return max(received, self._step[-1] - self._step[begin] + 1)

    def wait(self, seconds: float, most: float = math.inf) -> None:
        """Receive messages for a time [s], or until some were received."""
        self._client.spin_until(lambda: self.count >= most, seconds)

    def close(self) -> None:
        """Unsubscribe."""
        self._client.node.destroy_subscription(self._subscription)

    def samples(self, begin: int = 0, end: int | None = None) -> Samples:
        """Return the samples from one message to before another."""
        end = self.count if end is None else end
        n, arrival = len(self.source.fields), np.array(self._arrival[begin:end])
        return Samples(
            arrival,
            np.array(self._stamp[begin:end]),
            np.array(self._step[begin:end]),
            np.array(self._x[begin * n : end * n]).reshape(arrival.size, n),
        )

    def _on_message(self, message: Any) -> None:
        self.last = message
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        step = getattr(message, "step", -1)
        self._arrival.append(time.monotonic())
        self._stamp.append(to_seconds(stamp))
        self._step.append(step if isinstance(step, int) else -1)
        self._x.extend(read_field(path, message) for path in self.source.fields)


def listen(
    client: Client, topic: str, kind: str, paths: tuple[Path, ...], seconds: float,
    most: float = math.inf,
) -> Listener:  # fmt: skip
    """Listen to a topic for a time [s], or until some messages were received."""
    listener = Listener(client, topic, kind, paths)
    listener.wait(seconds, most)
    listener.close()
    return listener
