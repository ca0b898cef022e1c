"""The rig's command as a message: of any type with a number, or a ControlInput."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from koop_msgs.msg import ControlInput

from koop_core.config.fields import Path, check_fields, write_field
from koop_node.node.managed import message_type
from koop_node.node.qos import NEWEST, RELIABLE


class Command:
    """Publishes theta as the rig takes it.

    Parameters
    ----------
    create : callable
        ``create(kind, topic, qos)`` returns a publisher.
    name, topic : str
        Message type and topic.
    field : path
        Of theta in the message.

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
        if not self.answers:
            return self.say(theta)
        answer.theta = theta
        return self.publisher.publish(answer)
