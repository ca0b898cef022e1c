"""What the guard decides: theta within limits and rate, trips and rearms. Pure: no ROS.

Times are of the steady clock [s] and arguments. Whatever comes in, theta keeps its limits, and the
lines between knobs, and moves by no more than its rate allows in the time since it last moved; of a
time longer than ``late`` no more than that counts, so that it never jumps. Theta has a value for
each knob. Several move straight, the one that needs longest at its rate: as fast as each alone
would be there, and what is allowed at both ends of a way is so on it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum

from koop_core.config.knobs import format_knobs
from koop_guard.config import SAFETY, GuardConfig

ROUNDED = 1e-9  # share of a step by which rounding takes a controller beyond the rate


class Status(IntEnum):
    """What the guard does; as in GuardState."""

    WAITING = 0
    """Nothing is commanded: the controller has not answered yet."""
    FOLLOWING = 1
    """Theta moves to what the controller asks for."""
    TRIPPED = 2
    """Theta returns to theta_safe, or is there; latched."""


class Cause(str, Enum):
    """What trips the guard."""

    BEYOND = "channel beyond its limit"
    NOT_FINITE = "channel not finite"
    STUCK = "channel stuck"
    RIG_SILENT = "rig silent"
    RIG_DOUBLED = "rig doubled"
    SILENT = "controller silent"
    TOO_OLD = "controller too old"
    INACTIVE = "controller inactive"
    STILL = "guard stood still"
    DOUBLED = "controller doubled"
    BROKEN = "constraint broken"
    AT_LIMIT = "controller at a limit"
    OTHER = "another commander"
    ASKED = "asked"
    ENDED = "ended"


ONCE = (Cause.ASKED, Cause.AT_LIMIT, Cause.ENDED)  # do not last: a rearm clears them


@dataclass(frozen=True)
class Trip:
    """Why and where the guard tripped."""

    cause: Cause
    """The first one; later ones do not replace it."""
    reason: str
    """The same in words, with values."""
    when: float
    """Steady time [s]."""
    theta: tuple[float, ...]
    """Commanded then, a value for each knob."""
    x: tuple[float, ...]
    """Measured channels then; empty before the first."""


class RepeatMeter:
    """How often a channel repeats its value, and whether it does so for too long.

    Where a share p of the samples repeats the one before, n in a row do so by chance with
    probability p^n. All is known from the changes only: a run that lasts does not excuse itself.

    Nor is a channel stuck that rests: its motion has died away below its resolution. That is
    excluded in two ways. An oscillation takes its time to die away: a channel that has just moved
    by several steps about its recent mean does not rest. And noise does not die away: third
    differences, which hardly pass an oscillation of 8 samples or more, say how much of what moved
    the channel by few steps was noise; noise of more than 0.6 steps changes two samples in five.
    """

    def __init__(self) -> None:
        self._share = self._recent_share = SAFETY.stuck_at_first
        self._last, self._before = math.nan, (math.nan, math.nan, math.nan)
        self._mean = self._spread = self._noise = self._differences = 0.0
        self._resolution = math.inf
        self.run = 0
        """Repetitions in a row until now."""

    def hear(self, value: float) -> None:
        """Take the next value."""
        a, b, c = self._before
        self._before = (b, c, value)
        if not math.isnan(a):
            self._differences += abs(value - 3.0 * c + 3.0 * b - a)
        if value == self._last:
            self.run += 1
            return
        samples = self.run + 1
        weight = samples / (SAFETY.stuck_memory + samples)
        recent = samples / (SAFETY.stuck_recent + samples)
        self._share += weight * (self.run / samples - self._share)
        self._recent_share += recent * (self.run / samples - self._recent_share)
        if math.isnan(self._last):
            self._mean = value
        else:
            if (step := abs(value - self._last)) < self._resolution:
                self._resolution, self._noise = step, 0.0  # it was judged by too large a step
            self._mean += recent * (self._last - self._mean)
            self._spread += recent * (abs(self._last - self._mean) - self._spread)
            if not self._moves:
                self._noise += weight * (self._differences / samples - self._noise)
        self._differences = 0.0
        self.run, self._last = 0, value

    @property
    def _moves(self) -> bool:
        return self._spread >= SAFETY.stuck_steps * self._resolution

    @property
    def longest(self) -> float:
        """Repetitions in a row that neither chance nor rest explains."""
        noisy = self._noise >= SAFETY.stuck_noise * self._resolution
        if self._resolution < math.inf and not (self._moves or noisy):
            return math.inf
        share = max(self._share, self._recent_share, 1.0 / SAFETY.stuck_memory)
        return math.log(SAFETY.stuck_chance) / math.log(share)


class Guard:
    """Theta of one rig, which now has the values ``theta``."""

    def __init__(self, config: GuardConfig, theta: Sequence[float]) -> None:
        self._config = config
        self._silence = SAFETY.silence(config.period)
        self._late = max(SAFETY.late_periods * config.period, 2.0 * SAFETY.tick)
        self._rates = [rate * config.pace for rate in config.each("theta_rate")]
        self.theta = self.target = config.limit(theta)
        """Commanded now, and where it moves to."""
        self.status = Status.WAITING
        self.rearmed = 0
        """Automatic rearms since the last one by hand."""
        self.trip: Trip | None = None
        """The last one, also after a rearm."""
        self.x: tuple[float, ...] = ()
        self._repeats = [RepeatMeter() for _ in config.names]
        self._moved = math.inf
        self._arrived = self._answered = self._old = -math.inf
        self._saturated = self._calm = math.inf
        self._saturated_at = self.theta
        bounded = config.bounded
        window = bounded.window / config.pace if bounded else math.inf
        self._broken = max(SAFETY.broken * window, self._silence)
        self._margin, self._kept = math.nan, math.inf
        self._looked = math.inf
        self._causes: dict[Cause, tuple[str, float]] = {}

    @property
    def arrived(self) -> bool:
        """Whether theta is at its target."""
        return self.theta == self.target

    @property
    def at_safe(self) -> bool:
        """Whether theta is at theta_safe for good, until a rearm."""
        return self.status is Status.TRIPPED and self.theta == self.target

    def stand(self, theta: Sequence[float]) -> None:
        """Move on from a theta at which the rig stands, as it was restarted."""
        self.theta, self._moved = tuple(theta), math.inf

    def hear_state(self, x: Sequence[float], now: float) -> None:
        """Judge a sample of the rig."""
        self._arrived, self.x = now, tuple(x)
        config = self._config
        names = [n for n, value in zip(config.names, x, strict=False) if not math.isfinite(value)]
        if names:
            text = f"{', '.join(names)} on {config.source.topic} is not a finite number"
            return self.note(Cause.NOT_FINITE, text, now)
        if violation := describe_violation(config, x):
            self.note(Cause.BEYOND, violation, now)
        for name, value, meter in zip(config.names, x, self._repeats, strict=False):
            meter.hear(value)
            if meter.run * config.period > self._silence and meter.run > meter.longest:
                text = f"{name} = {value:.6g} has not changed for {meter.run} samples"
                self.note(Cause.STUCK, text, now)

    def hear_answer(
        self, theta: Sequence[float], saturated: bool, now: float, old: bool = False
    ) -> None:
        """Take what the controller asks for; ``old``: it answers what is long past."""
        if old:
            self._old = now
            return
        if not self._is_usable(theta):
            return
        self._answered = now
        if self.status is Status.TRIPPED:
            return
        self.status = Status.FOLLOWING
        self.target = self._config.limit(theta)
        if not (saturated and self._saturated < math.inf):
            self._saturated, self._saturated_at = now if saturated else math.inf, tuple(theta)
        limit = self._config.at_limit / self._config.pace
        if 0.0 < limit < now - self._saturated:
            knobs = list(zip(self._config.knob_names, theta, self._saturated_at, strict=True))
            resting = [knob for knob in knobs if knob[1] == knob[2]] or knobs
            where = " and ".join(f"{name} = {value:g}" for name, value, _ in resting)
            text = f"the controller is at {where}, its limit, for {now - self._saturated:.0f} s"
            self.note(Cause.AT_LIMIT, text, now)

    def hear_margin(self, margin: float, now: float) -> None:
        """Take the margin of the constraint; NaN: it is not known.

        Before it is known for the first time the controller holds theta, and nothing is broken.
        """
        self._margin = margin
        if margin >= 0.0 or (math.isinf(self._kept) and margin < 0.0):
            self._kept = now

    def hear_time(self, now: float) -> None:
        """Detect silence, and a constraint that was broken for too long.

        What it did not hear while it stood still itself is no silence of others.
        """
        if (still := now - self._looked) > self._silence:
            ages = [now - heard for heard in (self._arrived, self._answered) if heard > -math.inf]
            if ages and max(ages) > self._silence:
                self.note(Cause.STILL, f"the guard itself stood still for {still:.1f} s", now)
            self._arrived, self._answered, self._kept = (
                heard if math.isinf(heard) else min(heard + still, now)
                for heard in (self._arrived, self._answered, self._kept)
            )
        self._looked = now
        if (age := now - self._kept) > self._broken:
            constraint = f"the constraint {self._config.constraint}"
            left = f"its margin is {self._margin:.3g}"
            left = "its signal is not known" if math.isnan(self._margin) else left
            text = f"{constraint} is not kept for {age:.1f} s: {left}"
            if self._margin >= 0.0:  # the newest: it was kept then
                text = f"nothing new of {constraint} for {age:.1f} s"
            self.note(Cause.BROKEN, text, now)
        topic = self._config.source.topic
        if self._arrived > -math.inf and (age := now - self._arrived) > self._silence:
            self.note(Cause.RIG_SILENT, f"no message on {topic} for {age:.1f} s", now)
        heard = now - self._arrived < 0.5 * self._silence  # without a state there is no answer
        if heard and self._answered > -math.inf and (age := now - self._answered) > self._silence:
            if now - self._old < self._silence:
                text = f"the controller's answers are older than {self._silence:.1f} s"
                self.note(Cause.TOO_OLD, text, now)
            else:
                self.note(Cause.SILENT, f"the controller is silent for {age:.1f} s", now)
        self._calm = math.inf if self.refusal(now) else min(self._calm, now)

    def note(self, cause: Cause, reason: str, now: float) -> None:
        """Take note of a cause, now; the first one trips the guard and remains its reason."""
        self._causes[cause] = (reason, now)
        if self.status is not Status.TRIPPED:
            self.latch(Trip(cause, reason, now, self.theta, self.x))

    def latch(self, trip: Trip) -> None:
        """Be tripped from now on, also by what tripped a guard before this one."""
        self.trip = trip
        self.status, self.target = Status.TRIPPED, self._config.each("theta_safe")
        self._saturated = math.inf

    def refusal(self, now: float) -> str:
        """Return why the guard is not rearmed now; empty if it may be."""
        if self.status is not Status.TRIPPED:
            return "the guard has not tripped"
        if lasting := self._lasting(now):
            return "; ".join(lasting.values())
        where = format_knobs(self.theta, ".4g")
        return "" if self.at_safe else f"theta = {where} still returns to theta_safe"

    def rearm(self, now: float, by_hand: bool) -> None:
        """Let the controller command again, which begins at theta_safe."""
        self.rearmed = 0 if by_hand else self.rearmed + 1
        self.status, self._answered = Status.FOLLOWING, now

    def follow(self, first: float) -> None:
        """Follow a controller that answers by a time [s] for the first time, unless tripped."""
        if self.status is not Status.TRIPPED:
            self.status, self._answered = Status.FOLLOWING, first

    def go(self, theta: Sequence[float]) -> None:
        """Move to a theta, unless tripped; no controller is expected to answer."""
        if self.status is not Status.TRIPPED and self._is_usable(theta):
            self.status, self._answered = Status.FOLLOWING, -math.inf
            self.target = self._config.limit(theta)

    def may_rearm_itself(self, now: float) -> bool:
        """Return whether it is time for an automatic rearm."""
        return now > self.rearms_at

    @property
    def pause(self) -> float:
        """Time without a cause before an automatic rearm [s]; infinite where none comes."""
        trip = self.trip
        if self.status is not Status.TRIPPED or trip is None or trip.cause in ONCE:
            return math.inf
        if self.rearmed >= self._config.rearms:
            return math.inf
        return SAFETY.rearm_pause * 2.0**self.rearmed

    @property
    def rearms_at(self) -> float:
        """Steady time of the next automatic rearm [s]; infinite while that is not known."""
        return self._calm + self.pause

    def advance(self, now: float) -> tuple[float, ...]:
        """Move theta on to its target, as far as the rate allows, and return it."""
        elapsed, self._moved = now - self._moved, now
        return self.move(elapsed)

    def move(self, elapsed: float) -> tuple[float, ...]:
        """Move theta on by a time [s], of which no more than ``late`` counts, and return it."""
        counted = min(max(elapsed, 0.0), self._late)
        most = [rate * counted for rate in self._rates]
        changes = [b - a for a, b in zip(self.theta, self.target, strict=True)]
        if all(abs(c) <= m * (1.0 + ROUNDED) for c, m in zip(changes, most, strict=True)):
            self.theta = self.target
        elif counted > 0.0:
            times = [abs(c) / m for c, m in zip(changes, most, strict=True)]
            longest = max(times)
            self.theta = tuple(
                theta + math.copysign(m * (time / longest), c)
                for theta, c, m, time in zip(self.theta, changes, most, times, strict=True)
            )
        return self.theta

    def _is_usable(self, theta: Sequence[float]) -> bool:
        return len(theta) == len(self.theta) and all(map(math.isfinite, theta))

    def _lasting(self, now: float) -> dict[Cause, str]:
        """Return the causes that were there a moment ago."""
        calm = max(SAFETY.calm, self._silence)
        return {
            cause: reason for cause, (reason, when) in self._causes.items()
            if cause not in ONCE and now - when < calm
        }  # fmt: skip


def describe_violation(config: GuardConfig, x: Sequence[float]) -> str:
    """Return the channel that is beyond its limit, in words; empty if none is.

    >>> describe_violation(GuardConfig("a:x", "b:y", channel_max=(2.0,)), [3.0])
    'x = 3 is beyond its limit 2'
    """
    for limits, sense in ((config.channel_min, -1.0), (config.channel_max, 1.0)):
        for name, value, limit in zip(config.names, x, limits, strict=False):
            if sense * value > sense * limit:
                return f"{name} = {value:.6g} is beyond its limit {limit:g}"
    return ""
