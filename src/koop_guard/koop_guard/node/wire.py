"""The rig's command as a message: of any type with a number, or a ControlInput."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from koop_msgs.msg import ControlInput

from koop_core.config.fields import Path, check_fields, write_field
from koop_guard.config import SAFETY, GuardConfig
from koop_guard.guard import Guard
from koop_guard.note import THETA_LEFT
from koop_node.node.managed import message_type
from koop_node.node.qos import NEWEST, RELIABLE

SLOWER = 1e-3  # of a rig's clock: it refuses answers to steps that are still to come


class Command:
    """Publishes theta as the rig takes it.

    Parameters
    ----------
    create : callable
        ``create(kind, topic, qos)`` returns a publisher.
    name, topic : str
        Message type and topic.
    field : path
        Path to theta in the message.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If the type is not installed or has no such field.
    """

    def __init__(self, create: Callable[..., Any], name: str, topic: str, field: Path) -> None:
        kind = message_type(name)
        self._message, self._field = kind(), field
        self.answers = kind is ControlInput
        check_fields((field,), self._message)
        self.publisher = create(kind, topic, RELIABLE if self.answers else NEWEST)

    def say(self, theta: float, step: int = 0, header: Any = None) -> None:
        """Command a theta; a ControlInput answers a step and copies the header of its state."""
        write_field(self._field, self._message, theta)
        if self.answers:
            self._message.step, self._message.holding = max(step, 0), True
            if isinstance(header, type(self._message.header)):
                self._message.header = header
        self.publisher.publish(self._message)

    def pass_on(self, answer: Any, theta: float) -> None:
        """Command a theta with all else that the controller answered."""
        answer.theta = (theta,)
        if self.answers:
            self.publisher.publish(answer)
        else:
            self.say(theta)


class Return:
    """Whether theta has returned: it was at theta_safe for a while, or the rig is gone."""

    def __init__(self, guard: Guard, command: Command) -> None:
        self._guard, self._command = guard, command
        self._since = self._heard = time.monotonic()

    def is_over(self, now: float) -> bool:
        """Return whether nothing more needs to be commanded."""
        if self._command.publisher.get_subscription_count():
            self._heard = now
        if not self._guard.at_safe:
            self._since = now
        return now - self._since > SAFETY.held or now - self._heard > SAFETY.first


def describe_theta(guard: Guard, config: GuardConfig) -> str:
    """Say where theta is left."""
    return f"{THETA_LEFT} {guard.theta:g}; theta_safe = {config.theta_safe:g}"


def return_to_safe(
    guard: Guard,
    config: GuardConfig,
    command: Command,
    advance: Callable[[float], float],
    last: tuple[int, float],
) -> None:
    """Command theta until it has returned, where no states are heard any more.

    ``advance(now)`` moves theta on; ``last`` is the step of the newest state with the steady time
    at which it came [s]: a rig that is answered by its steps refuses answers to old ones.
    """
    over = Return(guard, command)
    step, came = last
    while not over.is_over(now := time.monotonic()):
        if command.publisher.get_subscription_count():
            passed = int((now - came) * (1.0 - SLOWER) / config.period)
            command.say(advance(now), step + passed)
        time.sleep(min(max(config.period, 0.001), SAFETY.tick))
