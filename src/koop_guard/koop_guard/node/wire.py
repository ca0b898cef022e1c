"""The rig's command as messages: of any type with a number for each knob, or a ControlInput."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from koop_msgs.msg import ControlInput

from koop_core.config.fields import Source, write_field
from koop_core.config.knobs import format_knobs
from koop_guard.config import SAFETY, GuardConfig
from koop_guard.guard import Guard
from koop_guard.note import THETA_LEFT
from koop_node.node.managed import message_type
from koop_node.node.qos import NEWEST, RELIABLE

SLOWER = 1e-3  # of a rig's clock: it refuses answers to steps that are still to come


class Command:
    """Publishes theta as the rig takes it.

    ``create(kind, topic, qos)`` returns a publisher; ``sources`` are topics, by their full names,
    and the fields that take theta of each knob, ``kinds`` their message types. Raises ConfigError
    if a type is not installed or has no such field.
    """

    def __init__(
        self, create: Callable[..., Any], sources: Sequence[Source], kinds: Sequence[str]
    ) -> None:
        self._messages, self.publishers = [], []
        for source, name in zip(sources, kinds, strict=True):
            kind = message_type(name, source.fields)
            self._messages.append((kind(), source.fields))
            qos = RELIABLE if kind is ControlInput else NEWEST
            self.publishers.append(create(kind, source.topic, qos))

    @property
    def is_heard(self) -> bool:
        """Whether the rig subscribes to any of it."""
        return any(publisher.get_subscription_count() for publisher in self.publishers)

    def say(self, theta: Sequence[float], step: int = 0, header: Any = None) -> None:
        """Command theta; a ControlInput answers a step and copies the header of its state."""
        for publisher, message in self._write(theta):
            if isinstance(message, ControlInput):
                message.step, message.holding = max(step, 0), True
                if isinstance(header, type(message.header)):
                    message.header = header
            publisher.publish(message)

    def pass_on(self, answer: Any, theta: Sequence[float]) -> None:
        """Command theta, a ControlInput with all else that the controller answered."""
        for publisher, message in self._write(theta):
            if isinstance(message, ControlInput):
                answer.theta, message = message.theta, answer
            publisher.publish(message)
        answer.theta = theta

    def _write(self, theta: Sequence[float]) -> Iterator[tuple[Any, Any]]:
        values = iter(theta)
        for publisher, (message, fields) in zip(self.publishers, self._messages, strict=True):
            for field in fields:
                write_field(field, message, next(values))
            yield publisher, message


class Return:
    """Whether theta has returned: it was at theta_safe for a while, or the rig is gone."""

    def __init__(self, guard: Guard, command: Command) -> None:
        self._guard, self._command = guard, command
        self._since = self._heard = time.monotonic()

    def is_over(self, now: float) -> bool:
        """Return whether nothing more needs to be commanded."""
        if self._command.is_heard:
            self._heard = now
        if not self._guard.at_safe:
            self._since = now
        return now - self._since > SAFETY.held or now - self._heard > SAFETY.first


def describe_theta(guard: Guard, config: GuardConfig) -> str:
    """Say where theta is left."""
    left, safe = format_knobs(guard.theta), format_knobs(config.each("theta_safe"))
    return f"{THETA_LEFT} {left}; theta_safe = {safe}"


def return_to_safe(
    guard: Guard,
    config: GuardConfig,
    command: Command,
    advance: Callable[[float], Sequence[float]],
    last: tuple[int, float],
) -> None:
    """Command theta until it has returned, where no states are heard any more.

    ``advance(now)`` moves theta on; ``last`` is the step of the newest state with the steady time
    at which it came [s]: a rig that is answered by its steps refuses answers to old ones.
    """
    over = Return(guard, command)
    step, came = last
    while not over.is_over(now := time.monotonic()):
        if command.is_heard:
            passed = int((now - came) * (1.0 - SLOWER) / config.period)
            command.say(advance(now), step + passed)
        time.sleep(min(max(config.period, 0.001), SAFETY.tick))
