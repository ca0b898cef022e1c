"""Configuration of the guard: the rig's limits, and when theta returns to theta_safe. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from koop_core.config.constraint import Constraint, Line, parse_constraint, parse_lines
from koop_core.config.fields import Source, parse_source, parse_sources
from koop_core.config.knobs import MOST, KnobSettings, format_knobs
from koop_core.config.parameter import ConfigError, NodeConfig, Settings, judged, parameter

THETA, ASKED = "theta", "theta_asked"
ROUNDED = 1e-12  # share of a line's terms that rounding may add to them


@dataclass(frozen=True)
class RigLimits(KnobSettings):
    """The rig: what is measured of it, what takes theta, and its limits.

    It has a knob for each field of the command. Raises ConfigError if a value has the wrong type,
    is out of range or contradicts another.
    """

    measured: str = parameter(
        "state:x[0]",
        "measured channels as topic:field,field, such as /joint_states:position[0],velocity[0]; "
        "all in one message, and only those that oscillate: one that drifts makes holds long",
        read_only=True,
    )
    command: str = parameter(
        "",
        "what takes theta, as topic:field, such as /rig/theta:data; the message type is the one "
        "that the rig subscribes to, and a koop_msgs/msg/ControlInput answers each state by its "
        "step; several knobs are /rig/gains:kp,kd or /rig/kp:data,/rig/kd:data",
        read_only=True,
    )
    dt: float = parameter(
        0.005, "time between two messages of the measured channels", unit="s", low=1e-6, high=1.0,
        read_only=True,
    )  # fmt: skip
    theta_min: float = parameter(
        -5.0, "least theta that may be commanded", read_only=True, per_knob=True
    )
    theta_max: float = parameter(
        5.0, "largest theta that may be commanded", read_only=True, per_knob=True
    )
    theta_rate: float = parameter(
        1.0, "largest change of theta per second of the rig's time, also while it returns",
        unit="1/s", low=1e-12, read_only=True, per_knob=True,
    )  # fmt: skip
    theta_start: float = parameter(
        0.0, "theta of the rig before any command", read_only=True, per_knob=True
    )
    theta_safe: float = parameter(
        0.0, "theta to which every command and every trip returns", read_only=True, per_knob=True
    )
    channel_min: tuple[float, ...] = parameter(
        (), "least value of each channel, below which theta returns to theta_safe; []: any",
        read_only=True,
    )  # fmt: skip
    channel_max: tuple[float, ...] = parameter(
        (), "largest value of each channel, above which theta returns to theta_safe; []: any",
        read_only=True,
    )  # fmt: skip
    constraint: str = parameter(
        "",
        "bound on a second signal that theta must keep, rms(/rig/effort:data, 10 s) < 1.5 or "
        "peak(...) over a window of so many seconds; theta returns to theta_safe where it is not "
        "kept for three windows; and lines between knobs, kp <= 20 kd or kp + 2 kd <= 3, which "
        "are always kept; several are separated by ';'; empty: none",
        read_only=True,
    )
    pace: float = parameter(
        1.0,
        "seconds of the rig's own time per second: 1, or N of a rig that is simulated at N times "
        "real time",
        low=1e-3, high=1e3, read_only=True,
    )  # fmt: skip
    on_alarm: str = parameter(
        "",
        "program, with its arguments, that runs when the guard of 'koop up' trips; "
        "KOOP_ALARM_REASON and the like in its environment say what happened; empty: none",
        read_only=True,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.command:
            raise ConfigError("command is missing: what takes theta, as /rig/theta:data")
        for name, parse in (("measured", parse_source), ("command", parse_sources)):
            try:
                parse(getattr(self, name))
            except ConfigError as error:
                raise ConfigError(f"{name}: {error}") from None
        if self.source.topic.lstrip("~/") in (c.topic.lstrip("~/") for c in self.commands):
            raise ConfigError(f"command = {self.command!r}: is the topic of the measured channels")
        self._check_knobs()
        self.check_counts("channel_min", "channel_max")
        parse_constraint(self.constraint)
        for name in ("theta_safe", "theta_start"):
            for line in self.lines:
                if line.excess(self.each(name)) >= 0.0:
                    raise ConfigError(
                        f"{name} = {format_knobs(self.each(name))}: must lie within {line.text}, "
                        "a constraint, and not at it"
                    )
        for low, high in zip(self.channel_min, self.channel_max, strict=False):
            if low >= high:
                raise ConfigError(
                    f"channel_min = {low:g} must be below channel_max = {high:g}: are they swapped?"
                )

    def _check_knobs(self) -> None:
        if self.count > MOST:
            raise ConfigError(f"command = {self.command!r}: names more than {MOST} knobs")
        for name, value in self._of_knobs().items():
            if isinstance(value, tuple) and len(value) != self.count:
                raise ConfigError(
                    f"{name} has {len(value)} values: the command has {self.count} field"
                    + "s" * (self.count > 1)
                )
        limits = zip(self.knob_names, self.each("theta_min"), self.each("theta_max"), strict=True)
        for i, (knob, low, high) in enumerate(limits):
            of = f" of {knob}" * (self.count > 1)
            if low >= high:
                raise ConfigError(
                    f"theta_min = {low:g}{of} must be below theta_max = {high:g}: are they swapped?"
                )
            for name in ("theta_start", "theta_safe"):
                if not low <= (value := self.each(name)[i]) <= high:
                    raise ConfigError(
                        f"{name} = {value:g}{of}: must lie within [theta_min, theta_max] = "
                        f"[{low:g}, {high:g}]"
                    )

    def check_counts(self, *names: str) -> None:
        """Raise ConfigError unless each of the named values has one number a channel, or none."""
        n = len(self.names)
        for name in names:
            if (count := len(getattr(self, name))) not in (0, n):
                raise ConfigError(f"{name} has {count} values: one for each of {n} channels, or []")

    @cached_property  # asked for with each message
    def source(self) -> Source:
        """Topic and fields of the measured channels."""
        return parse_source(self.measured)

    @cached_property
    def commands(self) -> tuple[Source, ...]:
        """Topics and fields of the command."""
        return parse_sources(self.command)

    @cached_property
    def count(self) -> int:
        """Number of knobs."""
        return sum(len(source.fields) for source in self.commands)

    @cached_property
    def knob_names(self) -> tuple[str, ...]:
        """Names of the knobs: of one theta, of several what tells their fields apart."""
        knobs = [(source.topic, name) for source in self.commands for name in source.names]
        topics = tuple(topic.rpartition("/")[2] for topic, _ in knobs)
        for names in (topics, tuple(name for _, name in knobs)):
            if len(set(names)) == len(knobs) > 1:
                return names
        return tuple(f"{topic}:{name}" for topic, name in knobs) if len(knobs) > 1 else ("theta",)

    @cached_property
    def bounded(self) -> Constraint | None:
        """The constraint; None without one."""
        return parse_constraint(self.constraint)

    @cached_property
    def lines(self) -> tuple[Line, ...]:
        """The lines between knobs."""
        limits = self.each("theta_min"), self.each("theta_max")
        lines = parse_lines(self.constraint, self.knob_names)
        return tuple(line.with_room(*limits, ROUNDED) for line in lines)

    def limit(self, theta: Sequence[float]) -> tuple[float, ...]:
        """Return theta within its limits and lines.

        Beyond a line it is drawn back straight towards theta_safe, as far as all lines ask for:
        limits and lines together are convex.
        """
        theta = self._clip(theta)
        if not self.lines:
            return theta
        safe, share = self.each("theta_safe"), 1.0
        for line in self.lines:
            if (excess := line.excess(theta)) > 0.5 * line.room:  # else it was drawn back already
                share = min(share, line.excess(safe) / (line.excess(safe) - excess))
        if share == 1.0:
            return theta
        return self._clip([a + share * (b - a) for a, b in zip(safe, theta, strict=True)])

    def _clip(self, theta: Sequence[float]) -> tuple[float, ...]:
        knobs = zip(theta, self._limits, strict=True)
        return tuple(min(max(value, low), high) for value, (low, high) in knobs)

    @cached_property  # asked for with each message
    def _limits(self) -> tuple[tuple[float, float], ...]:
        return tuple(zip(self.each("theta_min"), self.each("theta_max"), strict=True))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The channels, as the file writes them."""
        return self.source.names


@dataclass(frozen=True)
class GuardConfig(RigLimits):
    """The rig, as its rig file describes it, and what a trip and an end lead to."""

    at_limit: float = parameter(
        0.0, "time for which the controller may be at a limit of its theta; 0: any", unit="s",
        low=0.0, read_only=True,
    )  # fmt: skip
    rearms: int = parameter(
        0, "trips after which the guard rearms by itself; then only ~/rearm does", low=0,
        high=1000, read_only=True,
    )  # fmt: skip
    on_end: str = parameter(
        "safe",
        "what an orderly end leaves behind: theta at theta_safe, or held where it is",
        choices=("safe", "hold"), read_only=True,
    )  # fmt: skip
    note: str = parameter(
        "",
        "file that notes where theta of the rig was left, and a trip; empty: none",
        read_only=True,
    )

    @property
    def asked(self) -> str:
        """Topic of the controller: ``theta``, or another where the rig itself listens to that."""
        taken = THETA in (source.topic.lstrip("/") for source in self.commands)
        return ASKED if taken else THETA

    @property
    def period(self) -> float:
        """Time between two messages by the clock on the wall [s]."""
        return self.dt / self.pace

    @property
    def longest_return(self) -> float:
        """Time that theta needs from one limit to the other by the clock on the wall [s]."""
        return self._time_between(self.each("theta_min"), self.each("theta_max"))

    def return_time(self, theta: Sequence[float]) -> float:
        """Return how long theta takes to return to theta_safe [s], by the clock on the wall."""
        return self._time_between(theta, self.each("theta_safe"))

    def _time_between(self, a: Sequence[float], b: Sequence[float]) -> float:
        knobs = zip(a, b, self.each("theta_rate"), strict=True)
        return max(abs(y - x) / rate for x, y, rate in knobs) / self.pace


@dataclass(frozen=True)
class SafetySettings(Settings):
    """Times after which theta returns to theta_safe, and what its rate allows a late message."""

    late_periods: float = parameter(
        2.0, "periods of the rate that a late message may move theta by", low=1.0,
        origin="one message that is late by a whole period loses no speed",
    )  # fmt: skip
    silent_periods: float = judged(
        20.0, "periods without a message after which the rig is silent", low=2.0
    )
    silent: float = judged(
        1.0, "shortest time without a message after which the rig is silent", unit="s", low=0.1
    )
    broken: float = parameter(
        3.0, "windows of a constraint without a margin after which it is broken", low=1.0,
        origin="a window forgets what was before theta moved; then the barrier takes it back",
    )  # fmt: skip
    calm: float = parameter(
        2.5, "time for which a cause must be gone before a rearm", unit="s", low=0.0,
        origin="the graph is looked at once a second",
    )  # fmt: skip
    rearm_pause: float = judged(
        10.0, "least time without a cause before an automatic rearm; it doubles with each",
        unit="s", low=0.1
    )  # fmt: skip
    stuck_chance: float = parameter(
        1e-12, "chance of a run of equal values that counts as stuck", low=1e-300, high=1e-3,
        origin="less than one false alarm in a year at 1 kHz",
    )  # fmt: skip
    stuck_memory: float = judged(
        1000.0, "samples over which the share of repeated values and the noise are known", low=10.0
    )
    stuck_at_first: float = judged(
        0.99, "share of repeated values before anything is known", low=0.0, high=1.0
    )
    stuck_recent: float = parameter(
        25.0, "samples over which the recent motion of a channel is known", low=1.0,
        origin="simulated: an oscillation that dies away by 1/e in a period did not trip",
    )  # fmt: skip
    stuck_steps: float = judged(
        3.0, "steps of its resolution by which a channel must have moved to be stuck now", low=1.0
    )
    stuck_noise: float = parameter(
        2.5, "mean third difference of a noisy channel that moves less, in steps", low=2.0,
        origin="simulated: at most 2.4 of any oscillation with noise below 0.5 steps",
    )  # fmt: skip
    tick: float = judged(
        0.02, "time between two commands where no message asks for one", unit="s", low=1e-3,
        high=0.1
    )  # fmt: skip
    hang: float = judged(
        30.0, "time without a message of the command that set a target after which that hangs",
        unit="s", low=1.0
    )  # fmt: skip
    stopped: float = parameter(
        8.0, "time without a sign of life of the guard after which its twin kills it", unit="s",
        low=1.0, origin="on a busy machine threads waited for up to 4 s",
    )  # fmt: skip
    first: float = parameter(
        15.0, "time in which the command must get a subscriber, and the first message arrive",
        unit="s", low=1.0, origin="discovery takes up to 3 s on a quiet machine",
    )  # fmt: skip
    matched: float = parameter(
        2.0, "time after which a subscriber that is matched receives", unit="s", low=0.0,
        origin="1.4 s were seen on a busy machine",
    )  # fmt: skip
    alarm: float = judged(
        60.0, "time after which a program of on_alarm that still runs is killed", unit="s", low=1.0
    )
    held: float = judged(
        0.5, "time for which theta_safe is repeated before its publisher ends", unit="s", low=0.0
    )

    def silence(self, period: float) -> float:
        """Return the time without a message after which a rig is silent [s].

        ``period`` is the time between two messages on the same clock [s].
        """
        return max(self.silent, self.silent_periods * period)


SAFETY = SafetySettings()
GUARD: dict[str, tuple[type, ...]] = {"koop_guard": (GuardConfig, NodeConfig)}
