"""What theta may do, whoever asks: its limits, its rate, and when it must go home. Pure: no ROS."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from koop_tune.rig.rig_file import RigFile

HURRY = 2.0  # periods of which the rate counts at once, however late a message is
PERIODS = 20.0  # without a message, or a usable one, after which a rig counts as silent
LEAST_SILENCE = 1.0  # [s]
ROUNDED = 1e-9  # share of a step by which a controller that keeps the rate is beyond it


def silence(dt: float, scale: float = 1.0) -> float:
    """Return the time without a message after which a rig counts as silent [s]."""
    return max(LEAST_SILENCE, PERIODS * dt / scale)


@dataclass(frozen=True)
class Leash:
    """Keeps theta within its limits and rate, and knows when it must go home.

    Attributes
    ----------
    rig : RigFile
        Limits of theta and of the measured channels.
    theta : float
        Commanded now.
    target : float
        Where it goes.
    home : str
        Why it goes to the safe value, and follows no target any more; empty: it does not.
    """

    rig: RigFile
    theta: float
    target: float
    home: str = ""

    @property
    def there(self) -> bool:
        """Whether theta is where it goes."""
        return self.theta == self.target

    @property
    def safe(self) -> bool:
        """Whether theta is at the safe value, for good."""
        return bool(self.home) and self.there

    def asked(self, target: float) -> Leash:
        """Return it with another target, as near to it as the limits allow."""
        if self.home or not math.isfinite(target):
            return self
        within = min(max(target, self.rig.theta_min), self.rig.theta_max)
        return Leash(self.rig, self.theta, within)

    def called_home(self, reason: str) -> Leash:
        """Return it on its way to the safe value; the first reason stays."""
        return self if self.home else Leash(self.rig, self.theta, self.rig.theta_safe, reason)

    def moved(self, elapsed: float) -> Leash:
        """Return it after a time [s]; a late call moves theta by no more than two periods do."""
        most = self.rig.theta_rate * min(max(elapsed, 0.0), HURRY * self.rig.dt)
        change = self.target - self.theta
        near = abs(change) <= most * (1.0 + ROUNDED)
        theta = self.target if near else self.theta + math.copysign(most, change)
        return Leash(self.rig, theta, self.target, self.home)


def beyond(rig: RigFile, x: Sequence[float]) -> str:
    """Return which channel is beyond its limit, in words; empty if none is.

    >>> rig = RigFile("/a:x", "a/msg/A", "/b:y", "a/msg/B", 0.1, 0.0, 1.0, 1.0, channel_max=(2.0,))
    >>> beyond(rig, [3.0])
    'x = 3 is beyond its limit 2'
    """
    for name, value, limit in zip(rig.names, x, rig.channel_min, strict=False):
        if value < limit:
            return f"{name} = {value:.6g} is beyond its limit {limit:g}"
    for name, value, limit in zip(rig.names, x, rig.channel_max, strict=False):
        if value > limit:
            return f"{name} = {value:.6g} is beyond its limit {limit:g}"
    return ""


def way_home(rig: RigFile, theta: float) -> float:
    """Return how long the way to the safe value takes [s]."""
    return abs(theta - rig.theta_safe) / rig.theta_rate
