"""ROS node of the player: publishes the messages of a bag."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator, Mapping
from typing import Any

from std_srvs.srv import SetBool

from koop_bag.bag.playback import Playback
from koop_bag.bag.reader import BagReader, RawMessage
from koop_bag.bag.topics import is_common
from koop_bag.errors import BagError
from koop_bag.player.clock import BagClock
from koop_bag.player.config import FAST, PlayerConfig, parse_remap
from koop_bag.player.outlet import Outlet
from koop_core.config.parameter import ListenersConfig
from koop_core.errors import InputError
from koop_node.node.graph import listeners_of
from koop_node.node.main import run
from koop_node.node.managed import OK, Entities, ManagedNode, Run
from koop_node.node.schedule import Timer

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
        self._config = config
        self._names = {self._full(old): new for old, new in parse_remap(config.remap).items()}
        self._bag = BagReader(config.bag)
        entities.on_close(self._bag.close)
        outlets = self._make_outlets(config, entities)
        self._outlets = {outlet.topic: outlet for outlet in outlets}
        self._playback = Playback.of_bag(
            self._bag, [*self._outlets], rate=config.speed, loop=config.loop
        )
        if config.position:
            self._playback.seek(self._log_time(config.position), 0.0)
        if self._playback.finished:
            raise InputError(f"{config.bag} has no messages to play there")
        self._clock = BagClock(entities) if config.clock else None
        self._timer: Timer | None = None
        """There from the start of playing to the end of the active state."""
        entities.service(SetBool, "~/pause", self._on_pause)

    def activate(self, entities: Entities) -> None:
        _, observers = listeners_of(self._node.parameters[ListenersConfig].listeners, "")
        if observers.names:
            listeners = {outlet.publisher: observers for outlet in self._outlets.values()}
            entities.when_heard(listeners, lambda: self._start(entities))
        else:
            self._start_when_heard(entities)

    def deactivate(self) -> None:
        if self._timer is not None:
            self._timer = None
            self._playback.stop(time.monotonic())

    def check_parameters(self, configs: dict[type, Any], names: set[str]) -> None:
        if configs[PlayerConfig].position > self._bag.duration:
            raise InputError(f"position: the bag is {self._bag.duration:.3f} s long")

    def parameters_changed(self, names: set[str]) -> None:
        config, now = self._node.parameters[PlayerConfig], time.monotonic()
        self._config = config
        if "pace" in names:
            self._playback.set_rate(config.speed, now)
        if "loop" in names:
            self._playback.loop = config.loop
        if "position" in names:
            if self._clock is not None:
                self._clock.jump()
            try:
                self._playback.seek(self._log_time(config.position), now)
            except BagError as error:
                self._give_up(error)
        self._go_on()

    def samples(self) -> int:
        return sum(outlet.count for outlet in self._outlets.values())

    def diagnose(self) -> tuple[int, str, Mapping[str, object]]:
        position = self._playback.position(time.monotonic()) - self._bag.start_time
        values = {
            "messages": self.samples(),
            "position_s": f"{position * 1e-9:.3f}",
            "duration_s": f"{self._bag.duration:.3f}",
            "passes": self._playback.passes,
            "lateness_ms": f"{self._playback.lateness * 1e3:.3f}",
        }
        if self._timer is None:
            return OK, "waiting for subscribers" if self._node.active else "", values
        return OK, "paused" if self._playback.paused else "playing", values

    # -- set-up -------------------------------------------------------------------------------

    def _full(self, name: str) -> str:
        """Return the name that a topic has in a bag of this node's namespace."""
        return name if name.startswith("/") else f"{self._node.get_namespace().rstrip('/')}/{name}"

    def _log_time(self, position: float) -> int:
        return int(self._bag.start_time + round(position * 1e9))

    def _make_outlets(self, config: PlayerConfig, entities: Entities) -> Iterator[Outlet]:
        chosen = [self._full(name) for name in config.topics.split()]
        for name in chosen or [t.name for t in self._bag.topics if not is_common(t.name)]:
            topic = self._bag.topic(name)
            try:
                yield Outlet(entities, topic, self._names.get(name, name))
            except BagError as error:
                if chosen:
                    raise
                self._node.get_logger().warning(f"{name} is not played: {error}")

    def _start_when_heard(self, entities: Entities) -> None:
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

    def _start(self, entities: Entities) -> None:
        self._playback.start(time.monotonic())
        self._timer = entities.timer(SLICE, self._tick)
        self._node.get_logger().info(f"playing {', '.join(self._outlets)} of {self._bag.path}")
        self._tick()

    # -- playing ------------------------------------------------------------------------------

    def _tick(self) -> None:
        playback = self._playback
        if self._timer is None or self._node.exit_code is not None:
            return
        now = time.monotonic()
        until = now + SLICE
        try:
            while now < until and (message := playback.take(now)) is not None:
                self._publish(message)
                now = time.monotonic()
        except BagError as error:
            self._give_up(error)
            return
        if playback.finished:
            self._end()
            return
        wait = playback.wait(now)
        if self._clock is not None and self._config.pace != FAST and not playback.paused:
            wait = min(wait, self._clock.tick(playback.position(now)))
        self._wake_in(wait)

    def _publish(self, message: RawMessage) -> None:
        outlet = self._outlets[message.topic]
        if self._clock is not None:
            self._clock.publish(message.log_time)
        if self._config.pace == FAST:  # which nothing else slows down
            outlet.publish_acknowledged(message.data)
        else:
            outlet.publish(message.data)

    def _wake_in(self, wait: float) -> None:
        if self._timer is None:
            return
        if math.isinf(wait):
            self._timer.cancel()
        else:
            self._timer.restart(wait)

    def _go_on(self) -> None:
        """Look again for due messages, after the playback has changed."""
        self._wake_in(0.0)

    def _end(self) -> None:
        self._wake_in(math.inf)
        for outlet in self._outlets.values():
            outlet.wait_for_listeners(FAREWELL)
        self._node.get_logger().info(f"done: {self.samples()} messages")
        self._node.finish(0)

    def _give_up(self, error: BagError) -> None:
        """End at a place of the bag that cannot be read."""
        self._node.get_logger().error(str(error))
        self._node.finish(1)

    def _on_pause(self, request: SetBool.Request, answer: SetBool.Response) -> SetBool.Response:
        act = self._playback.pause if request.data else self._playback.resume
        act(time.monotonic())
        self._go_on()
        answer.success = True
        return answer


class PlayerNode(ManagedNode[PlayerRun]):
    """Plays while it is active, ends when all is played.

    Service: ``~/pause`` (std_srvs/SetBool: true pauses, false resumes). The parameters
    ``position``, ``pace`` and ``loop`` may be set at any time; setting ``position`` is a seek.
    """

    configs = (PlayerConfig, ListenersConfig)

    def __init__(self, name: str = "player", **options: Any) -> None:
        super().__init__(name, PlayerRun, **options)


def main() -> None:
    """Run the node until it is stopped."""
    sys.exit(run(PlayerNode))
