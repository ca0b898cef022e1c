"""Theta of a live rig, moved through the guard, which alone commands the rig."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

from koop_core.config.fields import read_field
from koop_core.config.knobs import format_knobs
from koop_core.errors import LiveError
from koop_guard.config import ASKED, THETA
from koop_guard.guard import Cause
from koop_node.client.client import Client
from koop_tune.rig.rig_file import RigFile

GUARD = "koop_guard"
SIGN_OF_LIFE = 1.0  # [s] between two messages to the guard
PATIENCE = 20.0  # [s] beyond the time to return, after which theta may be elsewhere
ROUNDED = 1e-6  # share of theta's range by which a command of few digits may be off


def guard_remaps(rig: RigFile) -> tuple[str, ...]:
    """Let ``theta`` be what the rig is told, ``theta_asked`` what a controller asks for."""
    asked = (f"relay_esc:{THETA}:={ASKED}",)
    if rig.guard.asked == ASKED:
        return asked
    return (*asked, f"{GUARD}:{THETA}:={ASKED}", f"{GUARD}:~/theta:={THETA}")


def guard_section(rig: RigFile, note: Path | None) -> dict[str, Any]:
    """Return the guard's parameters; the command itself says what trips it."""
    path = str(note.resolve()) if note is not None else ""
    values = asdict(replace(rig.guard, note=path, on_alarm=""))
    return {k: list(v) if isinstance(v, tuple) else v for k, v in values.items() if v != ()}


class GuardedTheta:
    """Theta, as the rig is told it.

    Parameters
    ----------
    client : Client
        Observer in the ROS domain.
    rig : RigFile
        The rig.
    command_types : sequence of str
        Message types of the command's topics, ``pkg/msg/Type``.
    theta : tuple of float
        Value that theta of each knob has now.
    """

    def __init__(
        self, client: Client, rig: RigFile, command_types: Sequence[str], theta: tuple[float, ...]
    ) -> None:
        from koop_msgs.msg import GuardState
        from rclpy.qos import qos_profile_sensor_data
        from std_msgs.msg import Float64MultiArray

        from koop_node.node.managed import message_type
        from koop_node.node.qos import KEPT

        self._client, self._rig = client, rig
        self._kinds = list(map(message_type, command_types))
        self._commands = [b""] * len(self._kinds)
        self._target, self._before = Float64MultiArray(data=theta), theta
        self._state = GuardState()
        self._said = -math.inf
        node = client.node
        self._publisher = node.create_publisher(Float64MultiArray, f"/{GUARD}/target", KEPT)
        node.create_subscription(GuardState, f"/{GUARD}/state", self._on_state, KEPT)
        for i, source in enumerate(rig.command_sources):
            hear = partial(self._commands.__setitem__, i)
            kind, qos = self._kinds[i], qos_profile_sensor_data
            node.create_subscription(kind, source.topic, hear, qos, raw=True)

    @property
    def value(self) -> tuple[float, ...]:
        """The last command to the rig, of each knob."""
        from koop_node.node.received import read_message

        messages = list(map(read_message, self._commands, self._kinds))
        if None in messages:  # not yet told, or not by the guard
            return self._before
        told = zip(self._rig.commands, messages, strict=True)
        return tuple(read_field(path, message) for of, message in told for path in of.fields)

    @property
    def arrived(self) -> bool:
        """Whether theta is at the target of :meth:`go`."""
        state = self._state
        return state.status == state.FOLLOWING and state.theta == self._target.data

    def go(self, theta: Sequence[float]) -> None:
        """Move theta of each knob to a value, within limits, lines and rate."""
        self._say(self._rig.limit(theta))

    def follow(self) -> None:
        """Let the controller, which begins at this theta, move it until :meth:`go`."""
        self._say([])

    def check(self) -> None:
        """Give a sign of life; raise LiveError if the guard returns theta to theta_safe."""
        state = self._state
        if state.status == state.TRIPPED:
            remedy = ""
            if state.cause == Cause.BEYOND.value:
                remedy = (
                    f" at theta = {format_knobs(state.tripped_theta, '.4g')}: if that was its "
                    "oscillation, narrow theta_min and theta_max until theirs is within, or widen "
                    "channel_min and channel_max as far as is safe; an excitation that has begun "
                    "then needs another --out"
                )
            raise LiveError(f"{state.reason}{remedy}")
        if time.monotonic() - self._said > SIGN_OF_LIFE:
            self._say(self._target.data)

    def wait_until_safe(self) -> None:
        """Wait until theta is at theta_safe, as it is once the guard has ended, or its twin.

        Raises
        ------
        koop_core.errors.LiveError
            If it may not be there.
        """
        rig, safe = self._rig, self._rig.each("theta_safe")
        if not any(self._commands):
            return  # it was never commanded
        spans = [scale.high - scale.low for scale in rig.scales]
        self._client.wait_for(
            lambda: all(
                abs(value - at) <= ROUNDED * span
                for value, at, span in zip(self.value, safe, spans, strict=True)
            ),
            rig.guard.longest_return + PATIENCE,
            f"theta may not be at theta_safe = {rig.spell('theta_safe')}",
        )

    def _say(self, target: Sequence[float]) -> None:
        self._said, self._target.data = time.monotonic(), target
        self._publisher.publish(self._target)

    def _on_state(self, state: Any) -> None:
        self._state = state
