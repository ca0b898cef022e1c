"""Configuration of the relay extremum-seeking controller; defaults are table 1 of the paper."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from koop_core.config.constraint import Line, parse_lines
from koop_core.config.knobs import KnobSettings, format_knobs
from koop_core.config.parameter import ConfigError, parameter
from relay_esc.barrier import BarrierParams, barrier_params
from relay_esc.directions import DirectionState, Knobs, bring_inside, start
from relay_esc.directions import recalled as recalled_directions
from relay_esc.elementary import exp, log
from relay_esc.relay import MEMORY, RelayParams, RelayState, dwell_samples, initial, recalled
from relay_esc.swing import SWING

ROOM = 1e-9  # share of a line's terms by which the controller stays within it; more than the guard


@dataclass(frozen=True)
class EscConfig(KnobSettings):
    """Relay, filter and saturation of the controller (paper section 2.2, table 1).

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If a value has the wrong type or is out of range, or the limits cross.
    """

    law: str = parameter(
        "relay",
        "relay: the paper's, which swings for ever; adaptive: a relay that shrinks its "
        "step when it has arrived and opens it again when the optimum moves",
        choices=("relay", "adaptive"),
        read_only=True,
    )
    theta_scale: str = parameter(
        "linear",
        "log: steps, step_size and rate_limit are of ln theta [Np]; theta_min must be above 0",
        choices=("linear", "log"),
        read_only=True,
    )
    step_size: float = parameter(
        0.005 / 15.0,
        "relay step k, the change of theta per sample; adaptive: the largest",
        low=0.0,
        high=10.0,
        per_knob=True,
    )
    step_ratio: float = parameter(
        0.1, "adaptive: smallest step in units of step_size", low=1e-4, high=1.0
    )
    dwell: float = parameter(
        15.0, "least time between two flips of the relay", unit="s", low=0.0, high=1e8
    )
    tau_f: float = parameter(
        10.0, "time constant of the high-pass filter on the cost", unit="s", low=1e-3, high=1e8
    )
    theta_min: float = parameter(
        -5.0, "lower saturation limit of theta", low=-1e6, high=1e6, per_knob=True
    )
    theta_max: float = parameter(
        5.0, "upper saturation limit of theta", low=-1e6, high=1e6, per_knob=True
    )
    widest: tuple[float, ...] = parameter(
        (),
        "adaptive: least and largest theta to which theta_min and theta_max open where the optimum "
        "is lost; []: they do not",
    )
    rate_limit: float = parameter(
        0.0,
        "largest change of theta per second, also after a reset or a change of its limits; 0: none",
        unit="1/s",
        low=0.0,
        high=1e6,
        per_knob=True,
    )
    objective: str = parameter(
        "minimise", "what the controller does with the cost", choices=("minimise", "maximise")
    )
    theta_initial: float = parameter(
        2.0,
        "theta at the start and after a reset; from beyond its limits it goes there at rate_limit",
        low=-1e6,
        high=1e6,
        per_knob=True,
    )
    begin: tuple[float, ...] = parameter(
        (),
        "what the controller goes on from, as 'koop up' has noted it; []: theta_initial",
        read_only=True,
    )
    constraint: str = parameter(
        "",
        "lines between knobs that theta keeps, theta[0] <= 20 theta[1] or theta[0] + 2 theta[1] <= "
        "3 and so on, separated by ';' (theta_scale log: ratios as the first); a bound on a signal "
        "is the lifter's; empty: none",
        read_only=True,
    )
    margin_slope: float = parameter(
        0.0,
        "change of the constraint's margin per unit of theta (theta_scale log: of ln theta), as "
        "'koop tune' found it: a barrier keeps the bound; 0: there is none",
        low=-1e9, high=1e9, read_only=True,
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.count > 1:
            if self.widest or self.margin_slope:
                raise ConfigError("widest and margin_slope are for one knob")
            if 0.0 in self.each("step_size"):
                raise ConfigError("step_size = 0: must be above 0 with several knobs")
            for line in self.lines:
                if line.excess(self.each("theta_initial")) > 0.0:
                    raise ConfigError(
                        f"theta_initial = {format_knobs(self.each('theta_initial'))}: must lie "
                        f"within {line.text}, a constraint"
                    )
                if self.theta_scale == "log" and line.as_ratio() is None:
                    raise ConfigError(
                        f"constraint: with theta_scale log a line is a ratio of two knobs, "
                        f"theta[0] <= 20 theta[1], not {line.text}"
                    )
            self.initial_directions()  # each knob is valid
            return
        parse_lines(self.constraint, ("theta",))
        if self.theta_min >= self.theta_max:
            raise ConfigError(
                f"theta_min = {self.theta_min:g} must be below theta_max = {self.theta_max:g}"
            )
        least, largest = self.limits if len(self.widest) in (0, 2) else (math.nan, math.nan)
        if not (least <= self.theta_min and self.theta_max <= largest):
            raise ConfigError(
                f"widest = {list(self.widest)}: must be [least, largest] theta, around theta_min "
                f"and theta_max, {self.theta_min:g} and {self.theta_max:g}"
            )
        inside = self.theta_min <= self.theta_initial <= self.theta_max
        if not inside and self.rate_limit == 0.0:
            raise ConfigError(
                f"theta_initial = {self.theta_initial:g} must lie within "
                f"[theta_min, theta_max] = [{self.theta_min:g}, {self.theta_max:g}], or "
                "rate_limit be above 0 for theta to go there"
            )
        if self.theta_scale == "log":
            for name, value in (("theta_min", least), ("theta_initial", self.theta_initial)):
                if value <= 0.0:
                    raise ConfigError(f"{name} = {value:g}: must be above 0 with theta_scale log")
        if self.begin and (len(self.begin) != MEMORY or self.begin[1] not in (1.0, -1.0)):
            raise ConfigError(f"begin: is not what a controller goes on from, {MEMORY} numbers")

    def knob(self, i: int, **others: Any) -> EscConfig:
        """Return the configuration of one knob alone, with ``others`` changed."""
        of_all = {"begin": (), "constraint": ""} if self.count > 1 else {}
        return super().knob(i, **{**of_all, **others})

    @property
    def limits(self) -> tuple[float, ...]:
        """Least and largest theta, the limits wide open."""
        return self.widest or (self.theta_min, self.theta_max)

    @property
    def lines(self) -> tuple[Line, ...]:
        """Lines between the knobs."""
        return parse_lines(self.constraint, [f"theta[{i}]" for i in range(self.count)])

    def scaled(self, theta: float) -> float:
        """Return u of a theta: theta itself, or its logarithm."""
        return log(theta) if self.theta_scale == "log" else theta

    def params(self, dt: float) -> RelayParams:
        """Return the values that ``relay_esc.relay.step`` takes at a sampling time [s]."""
        largest_change = self.rate_limit * dt if self.rate_limit > 0.0 else math.inf
        least, largest = self.limits
        return RelayParams(
            math.exp(-dt / self.tau_f),
            min(self.step_size, largest_change),
            dwell_samples(self.dwell, dt),
            self.scaled(least),
            self.scaled(largest),
            self.scaled(self.theta_min),
            self.scaled(self.theta_max),
            1.0 if self.objective == "minimise" else -1.0,
            largest_change,
            dwell_samples(max(self.dwell, self.tau_f), dt),
            self.law == "adaptive",
            math.exp(-dt / (SWING.level_time * max(self.dwell, dt))),
            self.step_ratio,
            self.theta_scale == "log",
            least,
            largest,
            self.theta_min,
            self.theta_max,
        )

    def barrier(self, dt: float) -> BarrierParams:
        """Return the values that ``relay_esc.barrier.answer`` takes at a sampling time [s]."""
        return barrier_params(self.margin_slope, dwell_samples(self.dwell, dt))

    def knob_limits(self, dt: float) -> Knobs:
        """Return what ``relay_esc.directions.answer`` takes besides the first knob's params."""
        each = [knob.params(dt) for knob in self.knobs()]
        unit, logarithmic = each[0].step_size or 1.0, each[0].logarithmic
        low, high = [p.u_low for p in each], [p.u_high for p in each]
        scale = np.array([p.step_size / unit for p in each])
        lines = [line.as_ratio() or line if logarithmic else line for line in self.lines]
        lines = [line.with_room(low, high, ROOM) for line in lines]
        normals = np.array([line.weights for line in lines]).reshape(-1, scale.size) * scale
        lengths = np.linalg.norm(normals, axis=1)
        return Knobs(
            np.array(low),
            np.array(high),
            scale,
            np.array([p.largest_change for p in each]),
            np.array([p.theta_low for p in each]),
            np.array([p.theta_high for p in each]),
            normals / lengths[:, None],
            np.array([line.bound - line.room for line in lines]) / lengths,
        )

    def initial_directions(self) -> DirectionState:
        """Return the state of the search along directions before the first sample."""
        each = [knob.initial() for knob in self.knobs()]
        begin = start(
            np.array([state.u for state in each]),
            np.array([state.epsilon for state in each]),
            np.array([state.commanded for state in each]),
            np.array([state.output for state in each]),
        )
        if self.count == 1:
            return begin._replace(relay=each[0])
        if self.begin:
            return recalled_directions(begin, self.begin, self.theta_scale == "log")
        if self.lines and not bring_inside.py_func(self.knob_limits(1.0), begin.base):
            raise ConfigError(
                f"constraint: no theta within theta_min and theta_max keeps {self.constraint}"
            )
        begin.begin[:] = begin.base
        return begin

    @property
    def beginning(self) -> float:
        """Where theta begins to seek: its initial value, or the limit beyond which that is."""
        return min(max(self.theta_initial, self.theta_min), self.theta_max)

    def initial(self) -> RelayState:
        """Return the relay's state before the first sample."""
        if self.begin:
            first = self.begin[0]
            theta = exp(first) if self.theta_scale == "log" else first
            return recalled(initial(first, 1, theta), self.begin)
        u, low, high = map(self.scaled, (self.beginning, self.theta_min, self.theta_max))
        down = u - low >= 0.25 * (high - low)  # as in the paper; else there is little way down
        begin = initial(u, 1 if down else -1, self.theta_initial)
        return begin._replace(commanded=self.scaled(self.theta_initial))
