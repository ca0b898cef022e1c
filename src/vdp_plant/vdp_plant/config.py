"""Configuration of the Van der Pol plant; defaults are table 1 of the paper."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from koop_core.config.knobs import KnobSettings
from koop_core.config.parameter import ConfigError, Settings, judged, parameter
from vdp_plant.dynamics import PlantKnobs, PlantParams


@dataclass(frozen=True)
class PacingSettings(Settings):
    """What the plant bears of the others before it gives up or says so."""

    resends: int = judged(3, "times that lockstep sends a state again before it gives up", low=0)
    held: float = judged(
        30.0, "time for which a subscriber that falls behind holds the plant", unit="s", low=0.1
    )  # DDS gives up before
    late: float = judged(
        0.02, "share of all ticks that may be late without a word", low=0.0, high=1.0
    )  # a busy machine has some


PACING = PacingSettings()


@dataclass(frozen=True)
class PlantConfig(KnobSettings):
    """Plant, forcing, interference and discretisation (paper section 3, table 1)."""

    epsilon0: float = parameter(1.0, "base damping coefficient", low=0.0, high=100.0)
    epsilon0_drift: float = parameter(
        1.0, "amplitude of the slow drift of the damping coefficient", low=0.0, high=100.0
    )
    drift_frequency: float = parameter(
        0.005,
        "frequency of the drift of the damping coefficient",
        unit="rad/s",
        low=0.0,
        high=100.0,
    )
    forcing_amplitude: float = parameter(
        2.2, "amplitude of the external forcing", unit="1/s^2", low=0.0, high=1000.0
    )
    forcing_frequency: float = parameter(
        4.5, "frequency of the external forcing", unit="rad/s", low=0.0, high=600.0
    )
    mu: float = parameter(
        1.0, "nominal frequency of the limit cycle", unit="rad/s", low=0.0, high=100.0
    )
    x_offset: float = parameter(6.0, "offset x0 of the oscillation", low=-1e3, high=1e3)
    theta_star: float = parameter(
        -3.0, "optimal control input; unknown to the controller", low=-100.0, high=100.0,
        per_knob=True,
    )  # fmt: skip
    coupling: tuple[float, ...] = parameter(
        (),
        "several knobs: matrix M, row by row, of which |M (theta - theta*)| takes the place of "
        "theta - theta*; []: the unit matrix",
        read_only=True,
    )
    interference_amplitude_1: float = parameter(
        10.5, "amplitude A1 of the measurement interference", low=0.0, high=1e3
    )
    interference_frequency_1: float = parameter(
        3.2, "first frequency of the measurement interference", unit="rad/s", low=0.0, high=600.0
    )
    interference_phase_1: float = parameter(
        0.0, "phase of the first interference component", unit="rad", low=-7.0, high=7.0
    )
    interference_amplitude_2: float = parameter(
        11.1, "amplitude A2 of the measurement interference", low=0.0, high=1e3
    )
    interference_frequency_2: float = parameter(
        7.8, "second frequency of the measurement interference", unit="rad/s", low=0.0, high=600.0
    )
    interference_phase_2: float = parameter(
        0.0, "phase of the second interference component", unit="rad", low=-7.0, high=7.0
    )
    dt: float = parameter(
        0.005, "integration and control step", unit="s", low=1e-6, high=1.0, read_only=True
    )
    theta_initial: float = parameter(
        2.0, "theta before the controller's first answer", low=-100.0, high=100.0, read_only=True,
        per_knob=True,
    )  # fmt: skip
    theta_min: float = parameter(
        -100.0, "lower bound of the actuator", low=-100.0, high=100.0, per_knob=True
    )
    theta_max: float = parameter(
        100.0, "upper bound of the actuator", low=-100.0, high=100.0, per_knob=True
    )
    theta_rate: float = parameter(
        0.0, "largest rate of the actuator; 0: no limit", unit="1/s", low=0.0, high=1e6,
        per_knob=True,
    )  # fmt: skip
    initial_state: tuple[float, ...] = parameter(
        (),
        "initial [x, y]; empty: uniform in [-3, 3] from the seed",
        low=-1e3,
        high=1e3,
        read_only=True,
    )
    seed: int = parameter(0, "seed of the initial state", low=0, high=2**31 - 1, read_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.initial_state) not in (0, 2):
            raise ConfigError(
                f"initial_state has {len(self.initial_state)} values: must be [x, y] or empty"
            )
        if self.count > 1:
            self.knobs(coupling=())  # each is valid
        if len(self.coupling) not in (0, self.count**2) or (self.coupling and self.count == 1):
            raise ConfigError(
                f"coupling has {len(self.coupling)} values: must be empty, or with several knobs "
                "their number's square"
            )
        if self.count == 1 and not self.theta_min <= self.theta_initial <= self.theta_max:
            raise ConfigError(
                f"theta_initial = {self.theta_initial:g} must lie within "
                f"[theta_min, theta_max] = [{self.theta_min:g}, {self.theta_max:g}]"
            )

    def params(self) -> PlantParams:
        """Return the values that the kernels of ``vdp_plant.dynamics`` take; of the first knob."""
        first = self.knob(0, coupling=())
        values = {name: getattr(first, name) for name in PlantParams._fields}
        return PlantParams(**{**values, "theta_rate": first.theta_rate or math.inf})

    def knob_params(self) -> PlantKnobs:
        """Return what the kernels take of all knobs."""
        n, each = self.count, [knob.params() for knob in self.knobs(coupling=())]
        coupling = np.reshape(self.coupling, (n, n)) if self.coupling else np.eye(n)
        return PlantKnobs(
            np.array([p.theta_min for p in each]),
            np.array([p.theta_max for p in each]),
            np.array([p.theta_rate for p in each]),
            np.array([p.theta_star for p in each]),
            coupling,
        )


def pace_values(text: str) -> dict[str, Any]:
    """Return the parameters of a pace: ``realtime``, ``lockstep`` or a number of times real time.

    >>> pace_values("2.5")
    {'pace': 'scaled', 'time_scale': 2.5}

    Raises ConfigError if it is none of them.
    """
    if text in ("realtime", "lockstep"):
        return {"pace": text}
    try:
        return {"pace": "scaled", "time_scale": float(text)}
    except ValueError:
        raise ConfigError(
            f"pace = {text!r}: must be realtime, lockstep or a number: so many times real time"
        ) from None


@dataclass(frozen=True)
class PaceConfig(Settings):
    """How the plant's time runs."""

    pace: str = parameter(
        "realtime",
        "realtime and scaled: timer, latest theta held; lockstep: every step waits for its theta",
        choices=("realtime", "lockstep", "scaled"),
        read_only=True,
    )
    time_scale: float = parameter(
        1.0, "simulated per real time at the pace 'scaled'", low=1e-3, high=1e3, read_only=True
    )
    duration: float = parameter(
        0.0,
        "simulated time after which the node ends; 0: never",
        unit="s",
        low=0.0,
        high=1e9,
        read_only=True,
    )
    publish_clock: bool = parameter(False, "publish simulated time on /clock", read_only=True)
    theta_timeout: float = parameter(
        2.0,
        "age at which theta is stale; 0: never. lockstep: the state is sent again, after "
        f"{PACING.resends} times the node gives up; realtime, scaled: theta is held",
        unit="s",
        low=0.0,
        high=1e6,
    )
    theta_safe_timeout: float = parameter(
        0.0,
        "realtime, scaled: age of theta at which theta_safe is applied instead; 0: never",
        unit="s",
        low=0.0,
        high=1e6,
    )
    theta_safe: float = parameter(
        0.0, "theta that is safe without a controller", low=-100.0, high=100.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if 0.0 < self.theta_safe_timeout < self.theta_timeout:
            raise ConfigError(
                f"theta_safe_timeout = {self.theta_safe_timeout:g} s must not be below "
                f"theta_timeout = {self.theta_timeout:g} s: theta is held first"
            )

    def period(self, dt: float) -> float:
        """Return the shortest real time between two steps of ``dt`` [s]; 0 in lockstep."""
        return 0.0 if self.pace == "lockstep" else dt / self.scale

    @property
    def scale(self) -> float:
        """Simulated per real time of the timed paces."""
        return self.time_scale if self.pace == "scaled" else 1.0

    def watch(self, age: float) -> str:
        """Return the watchdog's state at the paces realtime and scaled.

        ``age`` [s] is that of the theta that was received last; ``safe``: theta_safe is applied in
        its place.
        """
        if 0.0 < self.theta_safe_timeout < age:
            return "safe"
        if 0.0 < self.theta_timeout < age:
            return "holding"
        return "ok" if self.theta_timeout > 0.0 else "off"
