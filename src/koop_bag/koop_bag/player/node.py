"""ROS node of the player: publishes the messages of a bag."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from typing import Any

from rosgraph_msgs.msg import Clock

from koop_bag.bag.playback import in_time_order
from koop_bag.bag.reader import BagReader, RawMessage
from koop_bag.bag.topics import is_common
from koop_bag.errors import BagError
from koop_bag.player.config import PlayerConfig
from koop_bag.player.outlet import Outlet
from koop_core.errors import InputError, KoopError
from koop_node.node.managed import OK, Entities, ManagedNode, Run
from koop_node.node.qos import RELIABLE
from koop_node.node.schedule import Timer
from koop_node.node.stamps import to_stamp

SLICE = 0.005  # [s] of publishing after which services and answers have their turn
SETTLED = 0.3  # [s] without a new subscriber after which all that are coming have come
FAREWELL = 2.0  # [s] that the last messages may take to arrive


class PlayerRun(Run):
    """One bag being played."""

    def __init__(self, node: PlayerNode, entities: Entities) -> None:
        config = node.parameters[PlayerConfig]
        if not config.bag:
            raise InputError("no bag: set the parameter bag")
        self._node = node
        self._speed = config.speed
        self._bag = BagReader(config.bag)
        entities.on_close(self._bag.close)
        self._outlets = {o.topic: o for o in self._make_outlets(config, entities)}
        start = self._bag.start_time + round(config.start * 1e9)
        self._messages = in_time_order(self._bag.messages([*self._outlets], start))
        self._next = next(self._messages, None)
        if self._next is None:
            raise InputError(f"{config.bag} has no messages to play there")
        self._clock = entities.publisher(Clock, "/clock", RELIABLE) if config.clock else None
        self._timer: Timer | None = None
        """There from the start of playing to the end of the active state."""
        self._began = (0.0, 0)
        """Steady time [s] and log time [ns] of that start."""

    def activate(self, entities: Entities) -> None:
        """Start once there is a subscriber, and the others have had time to come, too."""
        before, since = 0, time.monotonic()

        def look() -> None:
            nonlocal before, since
            count = sum(o.publisher.get_subscription_count() for o in self._outlets.values())
            now = time.monotonic()
            if count != before:
                before, since = count, now
            elif count and now - since >= SETTLED:
                timer.cancel()
                self._start(entities)
            elif not count and now - since >= 5.0:
                since = now
                self._node.get_logger().info("waiting for a subscriber")

        timer = entities.timer(0.02, look)

    def deactivate(self) -> None:
        self._timer = None

    def samples(self) -> int:
        return sum(outlet.count for outlet in self._outlets.values())

    def diagnose(self) -> tuple[int, str, Mapping[str, object]]:
        if self._timer is not None:
            message = "playing"
        else:
            message = "waiting for subscribers" if self._node.active else ""
        return OK, message, {"messages": self.samples()}

    def _make_outlets(self, config: PlayerConfig, entities: Entities) -> Iterator[Outlet]:
        below = self._node.get_namespace().rstrip("/")
        chosen = [n if n.startswith("/") else f"{below}/{n}" for n in config.topics.split()]
        for name in chosen or [t.name for t in self._bag.topics if not is_common(t.name)]:
            topic = self._bag.topic(name)
            try:
                yield Outlet(entities, topic)
            except KoopError as error:
                if chosen:
                    raise
                self._node.get_logger().warning(f"{name} is not played: {error}")

    def _start(self, entities: Entities) -> None:
        assert self._next is not None
        self._began = (time.monotonic(), self._next.log_time)
        self._timer = entities.timer(SLICE, self._tick)
        self._node.get_logger().info(f"playing {', '.join(self._outlets)} of {self._bag.path}")
        self._tick()

    def _tick(self) -> None:
        """Publish what is due; an overdue message goes out at once, and none is left out."""
        if self._timer is None or self._node.exit_code is not None:
            return
        until = time.monotonic() + SLICE
        while (message := self._next) is not None:
            now = time.monotonic()
            start, log_time = self._began
            wait = start + (message.log_time - log_time) * 1e-9 / self._speed - now
            if wait > 0.0 or now >= until:
                self._timer.restart(max(wait, 0.0))
                return
            self._publish(message)
            try:
                self._next = next(self._messages, None)
            except BagError as error:
                self._node.get_logger().error(str(error))
                self._node.finish(1)
                return
        for outlet in self._outlets.values():
            outlet.wait_for_listeners(FAREWELL)
        self._node.get_logger().info(f"done: {self.samples()} messages")
        self._node.finish(0)

    def _publish(self, message: RawMessage) -> None:
        if self._clock is not None:
            self._clock.publish(Clock(clock=to_stamp(message.log_time)))
        # without a pace nothing else slows down
        self._outlets[message.topic].publish(message.data, acknowledged=math.isinf(self._speed))


class PlayerNode(ManagedNode[PlayerRun]):
    """Plays while it is active, ends when all is played."""

    configs = (PlayerConfig,)

    def __init__(self, name: str = "player", **options: Any) -> None:
        super().__init__(name, PlayerRun, **options)
