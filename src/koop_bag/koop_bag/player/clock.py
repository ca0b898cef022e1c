"""/clock of the player: at every message, and between them."""

from __future__ import annotations

import math

from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock

from koop_bag.bag.reader import RawMessage
from koop_bag.cdr.header import stamp_of
from koop_node.node.managed import Entities
from koop_node.node.qos import RELIABLE
from koop_node.node.stamps import to_stamp

PERIOD = 0.005  # [s] between clock messages where the bag is silent


class ClockOutlet:
    """Publishes the time of the bag.

    Parameters
    ----------
    entities : Entities
        Owner of the publisher.
    kind : str
        `off`, `receive` (the log time of each message) or `stamp` (each new header stamp).
    flows : bool
        Whether time passes between two messages, so that it is told there as well.
    stamped : set of str
        Topics whose messages begin with a header.
    """

    def __init__(self, entities: Entities, kind: str, flows: bool, stamped: set[str]) -> None:
        self._kind, self._flows, self._stamped = kind, flows and kind == "receive", stamped
        self._last = -1
        self._publisher: Publisher | None = (
            entities.publisher(Clock, "/clock", RELIABLE) if kind != "off" else None
        )

    def before(self, message: RawMessage) -> None:
        """Tell the time of a message that goes out next."""
        if self._kind == "receive":
            self._publish(message.log_time)
        elif self._kind == "stamp" and message.topic in self._stamped:
            self._publish(stamp_of(message.data))

    def between(self, position: int) -> float:
        """Tell the time where no message is due; return when to call again [s]."""
        if not self._flows:
            return math.inf
        if position > self._last:
            self._publish(position)
        return PERIOD

    def jump(self) -> None:
        """Time may go back now."""
        self._last = -1

    def _publish(self, nanoseconds: int) -> None:
        if nanoseconds != self._last and self._publisher is not None:
            self._last = nanoseconds
            self._publisher.publish(Clock(clock=to_stamp(nanoseconds)))
