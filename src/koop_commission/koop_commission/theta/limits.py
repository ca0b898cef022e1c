"""Limits of theta: range, rate, and when it returns to theta_safe. Pure: no ROS."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from koop_core.config.parameter import parameter, validate
from koop_tune.rig.rig_file import RigFile

_JUDGED = "judgement"
ROUNDED = 1e-9  # share of a step by which rounding takes a controller beyond the rate


@dataclass(frozen=True)
class SafetySettings:
    """Times after which theta returns to theta_safe, and what its rate allows a late message.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If a value has the wrong type or is out of range.
    """

    late_periods: float = parameter(
        2.0, "periods of the rate that a late message may move theta by", low=1.0,
        origin="one message that is late by a whole period loses no speed",
    )  # fmt: skip
    silent_periods: float = parameter(
        20.0, "periods without a usable message after which the rig is silent", low=2.0,
        origin=_JUDGED,
    )  # fmt: skip
    silent: float = parameter(
        1.0, "shortest time without a usable message after which the rig is silent", unit="s",
        low=0.1, origin=_JUDGED,
    )  # fmt: skip
    hang: float = parameter(
        30.0, "time without a sign of life of the command after which it hangs", unit="s", low=1.0,
        origin=_JUDGED,
    )  # fmt: skip
    first: float = parameter(
        15.0, "time in which the command must get a subscriber, and the first message arrive",
        unit="s", low=1.0, origin="discovery takes up to 3 s on a quiet machine",
    )  # fmt: skip
    matched: float = parameter(
        2.0, "time after which a subscriber that is matched receives", unit="s", low=0.0,
        origin="1.4 s were seen on a busy machine",
    )  # fmt: skip
    held: float = parameter(
        0.5, "time for which theta_safe is repeated before the commander ends", unit="s", low=0.0,
        origin=_JUDGED,
    )  # fmt: skip

    def __post_init__(self) -> None:
        validate(self)

    def silence(self, rig: RigFile) -> float:
        """Return the time without a usable message after which a rig is silent [s]."""
        return max(self.silent, self.silent_periods * rig.dt / rig.pace)


SAFETY = SafetySettings()


@dataclass(frozen=True)
class LimitedTheta:
    """Theta within its limits and its rate; an immutable value.

    Attributes
    ----------
    rig : RigFile
        Limits of theta and of the measured channels.
    theta : float
        Commanded now.
    target : float
        Value that it moves to.
    reason : str
        Why it returns to theta_safe and follows no target any more; empty: it does not.
    """

    rig: RigFile
    theta: float
    target: float
    reason: str = ""

    @property
    def arrived(self) -> bool:
        """Whether theta is at its target."""
        return self.theta == self.target

    @property
    def safe(self) -> bool:
        """Whether theta is at theta_safe, for good."""
        return bool(self.reason) and self.arrived

    def aim(self, target: float) -> LimitedTheta:
        """Return it with another target, as near to it as the limits allow."""
        if self.reason or not math.isfinite(target):
            return self
        return replace(self, target=min(max(target, self.rig.theta_min), self.rig.theta_max))

    def give_up(self, reason: str) -> LimitedTheta:
        """Return it with theta_safe as its last target; the first reason stays."""
        return self if self.reason else replace(self, target=self.rig.theta_safe, reason=reason)

    def advance(self, elapsed: float, settings: SafetySettings = SAFETY) -> LimitedTheta:
        """Return it after a time [s]; a late call moves theta by no more than two periods do."""
        longest = settings.late_periods * self.rig.dt
        most = self.rig.theta_rate * min(max(elapsed, 0.0), longest)
        change = self.target - self.theta
        near = abs(change) <= most * (1.0 + ROUNDED)
        return replace(
            self, theta=self.target if near else self.theta + math.copysign(most, change)
        )


def describe_violation(rig: RigFile, x: Sequence[float]) -> str:
    """Return the channel that is beyond its limit, in words; empty if none is.

    >>> rig = RigFile("/a:x", "a/msg/A", "/b:y", "a/msg/B", 0.1, 0.0, 1.0, 1.0, channel_max=(2.0,))
    >>> describe_violation(rig, [3.0])
    'x = 3 is beyond its limit 2'
    """
    for limits, sense in ((rig.channel_min, -1.0), (rig.channel_max, 1.0)):
        for name, value, limit in zip(rig.names, x, limits, strict=False):
            if sense * value > sense * limit:
                return f"{name} = {value:.6g} is beyond its limit {limit:g}"
    return ""


def compute_return_time(rig: RigFile, theta: float) -> float:
    """Return how long theta takes to return to theta_safe [s], by the clock on the wall."""
    return abs(theta - rig.theta_safe) / rig.theta_rate / rig.pace
