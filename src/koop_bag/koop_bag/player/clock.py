"""/clock of the player: at every message, and between them."""

from __future__ import annotations

from rosgraph_msgs.msg import Clock

from koop_node.node.managed import Entities
from koop_node.node.qos import RELIABLE
from koop_node.node.stamps import to_stamp

PERIOD = 0.005  # [s] between clock messages where the bag is silent


class BagClock:
    """Publishes the time of the bag.

    Parameters
    ----------
    entities : Entities
        Owner of the publisher.
    """

    def __init__(self, entities: Entities) -> None:
        self._last = -1
        self._publisher = entities.publisher(Clock, "/clock", RELIABLE)

    def publish(self, nanoseconds: int) -> None:
        """Publish the time of a message that goes out next."""
        if nanoseconds != self._last:
            self._last = nanoseconds
            self._publisher.publish(Clock(clock=to_stamp(nanoseconds)))

    def tick(self, position: int) -> float:
        """Publish the time where no message is due; return when to call again [s]."""
        if position > self._last:
            self.publish(position)
        return PERIOD

    def jump(self) -> None:
        """Let time go back."""
        self._last = -1
