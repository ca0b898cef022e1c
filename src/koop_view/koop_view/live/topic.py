"""A subscription whose messages are fetched, as bytes, by polling."""

from __future__ import annotations

import time
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from koop_bag.recorder.topics import message_class, polled

WAITING = 200  # messages that DDS keeps between two polls; of more, the oldest are lost


class ViewedTopic:
    """A topic that is viewed.

    Topics of a loop are read best effort: no writer keeps or repeats anything for a viewer.

    Parameters
    ----------
    node : rclpy.node.Node
        Owner; its executor must not get to see the subscription.
    name, type_name : str
        Full name and type of the topic.
    reliable : bool
        Whether what was lost on the way is sent again.
    kept : bool
        Whether the last messages from before are wanted, which takes reliable delivery.
    """

    def __init__(self, node: Node, name: str, type_name: str, reliable: bool, kept: bool) -> None:
        self._node = node
        self._type = message_class(type_name)
        profile = QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=WAITING,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE,
        )
        self._subscription: Any = node.create_subscription(
            self._type,
            name,
            polled,
            profile,
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )

    def take(self) -> list[tuple[int, bytes]]:
        """Return the messages that wait, each with the time [ns] at which it came."""
        taken: list[tuple[int, bytes]] = []
        take, kind = self._subscription.handle.take_message, self._type
        for _ in range(WAITING):
            item = take(kind, True)
            if item is None:
                break
            data, info = item
            taken.append((info["received_timestamp"] or time.time_ns(), data))
        return taken

    def close(self) -> None:
        """Listen no more."""
        self._node.destroy_subscription(self._subscription)
