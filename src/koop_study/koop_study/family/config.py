"""Ranges and shares of a family of rigs, declared in an experiment file."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

from koop_core.config.parameter import ConfigError, Settings, parameter

BOWLS = ("symmetric", "asymmetric", "one-sided", "flat-bottomed")
WITH_OPTIMUM = (*BOWLS, "narrow", "two-valleys", "two-modes")
WITHOUT_OPTIMUM = ("monotone", "flat", "drowned")
MAPS = (*WITH_OPTIMUM, *WITHOUT_OPTIMUM)

LOGARITHMIC = (
    "frequency", "theta_scale", "depth", "amplitude_time", "amplitude", "noise", "interference",
    "width", "skirts", "shallower", "quicker",
)  # fmt: skip
share = partial(parameter, low=0.0, high=1.0)


@dataclass(frozen=True)
class FamilyConfig(Settings):
    """Ranges [low, high] that a rig's constants are drawn from, and shares of its kinds.

    L is the level that theta leads to, L* the one at the optimum u*, tau the time constant of the
    amplitude; a range of :data:`LOGARITHMIC` is drawn from log-uniformly.
    """

    frequency: tuple[float, ...] = parameter(
        (0.05, 50.0), "of the oscillation", unit="Hz", low=1e-3, high=1e3
    )
    theta_scale: tuple[float, ...] = parameter(
        (1e-3, 1e3), "width of a linear range of theta; ends of a log-scaled one", low=1e-6,
        high=1e6,
    )  # fmt: skip
    optimum: tuple[float, ...] = parameter((0.1, 0.9), "u*, in theta's range", low=0.05, high=0.95)
    depth: tuple[float, ...] = parameter(
        (2.0, 20.0), "largest level over smallest, at the farther end", low=1.01, high=1e3
    )
    flat: tuple[float, ...] = parameter(
        (0.03, 0.1), "half the width of a flat bottom", low=0.0, high=0.4
    )
    power: tuple[float, ...] = parameter(
        (1.0, 1.5), "p of the map, but a narrow one's", low=0.5, high=4.0
    )
    width: tuple[float, ...] = parameter(
        (0.01, 0.05), "width of a narrow valley: where L is at most sqrt(2) L*", low=1e-3, high=0.5
    )
    skirts: tuple[float, ...] = parameter(
        (0.05, 0.15), "half its width where L^2 is half of that far away; p follows, 0.5 to 2",
        low=0.01, high=1.0,
    )  # fmt: skip
    shallower: tuple[float, ...] = parameter(
        (2.0, 4.0), "two valleys: level at the bottom of the wide one over L*", low=1.5, high=100.0
    )
    apart: tuple[float, ...] = parameter(
        (0.35, 0.5), "distance of the two valleys", low=0.2, high=0.5
    )
    second: tuple[float, ...] = parameter(
        (2.0, 4.0), "two modes: frequency of the second over the first's", low=1.5, high=5.0
    )
    play: tuple[float, ...] = parameter((0.0, 0.0), "backlash of theta, in u", low=0.0, high=0.2)
    amplitude_time: tuple[float, ...] = parameter(
        (2.0, 200.0), "tau at the optimum in periods, and its limits everywhere", low=1.0, high=1e4
    )
    quicker: tuple[float, ...] = parameter(
        (1.0, 1.0), "times less than the lower limit that tau may be elsewhere", low=1.0, high=1e3
    )
    growth: tuple[float, ...] = parameter(
        (0.0, 1.0), "g of a limit cycle, whose tau goes as (L / L*)^-g", low=0.0, high=3.0
    )
    amplitude: tuple[float, ...] = parameter(
        (1e-3, 1e3), "L*, in the channels' unit", low=1e-6, high=1e6
    )
    noise: tuple[float, ...] = parameter(
        (0.01, 0.3), "rms of noise over the oscillation's at its middle level", low=1e-6, high=1e3
    )
    interference: tuple[float, ...] = parameter(
        (0.1, 10.0), "the same of interference, of the rigs that have any", low=1e-3, high=1e3
    )
    lower_tones: tuple[float, ...] = parameter(
        (0.1, 0.6), "frequency of an interference over the oscillation's", low=1e-3, high=8.0
    )
    upper_tones: tuple[float, ...] = parameter(
        (1.6, 4.0), "the same, with the same probability", low=1e-3, high=8.0
    )
    drift: tuple[float, ...] = parameter(
        (0.0, 0.1), "motion of u* in an hour, or in a hundred slowest tau if longer: no law "
        "follows an optimum that leaves faster than the amplitude answers", low=0.0, high=10.0,
    )  # fmt: skip
    harmonic: tuple[float, ...] = parameter(
        (0.0, 0.2), "second harmonic of a channel", low=0.0, high=1.0
    )
    jitter: tuple[float, ...] = parameter(
        (0.0, 0.05), "random walk of a limit cycle's phase in a period", unit="rad", low=0.0,
        high=1.0,
    )  # fmt: skip
    channels: tuple[float, ...] = parameter((1.0, 4.0), "measured channels", low=1, high=8)
    noise_driven: float = share(0.5, "of noise-driven oscillators")
    log_scaled: float = share(0.3, "of log-scaled theta")
    maximised: float = share(0.2, "of maps to be maximised")
    quiet: float = share(0.25, "of rigs without measurement noise")
    clean: float = share(0.25, "of rigs without interference")
    common: float = share(0.5, "of interferences that reach all channels alike")
    maps: dict[str, float] = field(default_factory=lambda: dict.fromkeys(BOWLS, 1.0))
    """Weights: :data:`WITH_OPTIMUM` have an optimum, the others none that can be found."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, value in vars(self).items():
            if isinstance(value, tuple) and not (len(value) == 2 and value[0] <= value[1]):
                raise ConfigError(
                    f"{name} = {list(value)}: must be two numbers, the smaller one first"
                )
        for name, weight in self.maps.items():
            if name not in MAPS or weight < 0.0:
                raise ConfigError(f"maps.{name} = {weight:g}: known are {', '.join(MAPS)}, from 0")
        if not sum(self.maps.values()) > 0.0:
            raise ConfigError("maps: none has a weight above 0")
