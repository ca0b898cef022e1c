"""Ranges and shares of a family of rigs, declared in an experiment file."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

from koop_core.config.parameter import ConfigError

Range = tuple[float, ...]
BOWLS = ("symmetric", "asymmetric", "one-sided", "flat-bottomed")
WITH_OPTIMUM = (*BOWLS, "narrow", "two-valleys", "two-modes")
WITHOUT_OPTIMUM = ("monotone", "flat", "drowned")
MAPS = (*WITH_OPTIMUM, *WITHOUT_OPTIMUM)

LOGARITHMIC = (
    "frequency", "theta_scale", "depth", "amplitude_time", "amplitude", "noise", "interference",
    "width", "skirts", "shallower", "quicker",
)  # fmt: skip
LIMITS = {  # what the ranges may be at most
    "channels": (1, 8), "frequency": (1e-3, 1e3), "theta_scale": (1e-6, 1e6),
    "optimum": (0.05, 0.95), "depth": (1.01, 1e3), "flat": (0.0, 0.4), "power": (0.5, 4.0),
    "amplitude_time": (1.0, 1e4), "amplitude": (1e-6, 1e6), "noise": (1e-6, 1e3),
    "interference": (1e-3, 1e3), "drift": (0.0, 10.0), "harmonic": (0.0, 1.0),
    "jitter": (0.0, 1.0), "width": (1e-3, 0.5), "skirts": (0.01, 1.0),
    "shallower": (1.5, 100.0), "apart": (0.2, 0.5), "second": (1.5, 5.0), "play": (0.0, 0.2),
    "quicker": (1.0, 1e3), "growth": (0.0, 3.0), "lower_tones": (1e-3, 8.0),
    "upper_tones": (1e-3, 8.0),
}  # fmt: skip


@dataclass(frozen=True)
class FamilyConfig:
    """Ranges [low, high] that a rig's constants are drawn from, and shares of its kinds.

    Attributes
    ----------
    frequency : Range
        Frequency of the oscillation [Hz], log-uniform; 20 to 50 samples a period.
    theta_scale : Range
        Width of a linear range of theta, and the ends that a log-scaled one lies within.
    optimum : Range
        u*, position of the optimum in theta's range.
    depth : Range
        Largest level over smallest, at the farther end of the range; log-uniform.
    flat : Range
        Half the width of the bottom, of the maps that have one.
    power : Range
        p of the map; a narrow one has its own.
    width : Range
        Width of a narrow valley: where L is at most sqrt(2) L*; log-uniform.
    skirts : Range
        Half the width of a narrow valley where L^2 is half of that far away; log-uniform. p, 0.5
        to 2, follows from width, skirts and depth.
    shallower, apart : Range
        Two valleys: level at the bottom of the wide one over L*, log-uniform; their distance.
    second : Range
        Two modes: frequency of the second over the first's.
    play : Range
        Backlash of theta, in u.
    amplitude_time : Range
        tau at the optimum in periods, log-uniform, and its limits wherever theta is.
    quicker : Range
        How many times less than the lower limit tau may be elsewhere; log-uniform.
    growth : Range
        g of a limit cycle, whose tau goes as (L / L*)^-g.
    amplitude : Range
        L* in the unit of the channels, log-uniform.
    noise, interference : Range
        Rms of measurement noise and of interference over the rms of the oscillation at its middle
        level; log-uniform, of the rigs that have any.
    lower_tones, upper_tones : Range
        Frequency of an interference over the oscillation's: of each in either with the same
        probability.
    drift : Range
        Motion of u* in an hour, or in a hundred slowest tau where these are longer: no law follows
        an optimum that leaves faster than the amplitude answers.
    harmonic, jitter : Range
        Second harmonic of a channel; random walk of the phase of a limit cycle in a period [rad].
    channels : Range
        How many are measured.
    noise_driven, log_scaled, maximised, quiet, clean, common : float
        Shares: of noise-driven oscillators, of log-scaled theta, of maps to be maximised, of rigs
        without measurement noise, without interference, with one that reaches all channels alike.
    maps : dict of str to float
        Weights: :data:`WITH_OPTIMUM` have an optimum; ``monotone``, ``flat`` and ``drowned`` have
        none that can be found. By default those with one wide valley, alike.
    """

    frequency: Range = (0.05, 50.0)
    theta_scale: Range = (1e-3, 1e3)
    optimum: Range = (0.1, 0.9)
    depth: Range = (2.0, 20.0)
    flat: Range = (0.03, 0.1)
    power: Range = (1.0, 1.5)
    width: Range = (0.01, 0.05)
    skirts: Range = (0.05, 0.15)
    shallower: Range = (2.0, 4.0)
    apart: Range = (0.35, 0.5)
    second: Range = (2.0, 4.0)
    play: Range = (0.0, 0.0)
    amplitude_time: Range = (2.0, 200.0)
    quicker: Range = (1.0, 1.0)
    growth: Range = (0.0, 1.0)
    amplitude: Range = (1e-3, 1e3)
    noise: Range = (0.01, 0.3)
    interference: Range = (0.1, 10.0)
    lower_tones: Range = (0.1, 0.6)
    upper_tones: Range = (1.6, 4.0)
    drift: Range = (0.0, 0.1)
    harmonic: Range = (0.0, 0.2)
    jitter: Range = (0.0, 0.05)
    channels: Range = (1, 4)
    noise_driven: float = 0.5
    log_scaled: float = 0.3
    maximised: float = 0.2
    quiet: float = 0.25
    clean: float = 0.25
    common: float = 0.5
    maps: dict[str, float] = field(default_factory=lambda: dict.fromkeys(BOWLS, 1.0))

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, tuple):
                low, high = LIMITS[item.name]
                if len(value) != 2 or not low <= value[0] <= value[1] <= high:
                    raise ConfigError(
                        f"{item.name} = {list(value)}: must be two numbers, the smaller one first, "
                        f"within {low:g} to {high:g}"
                    )
            elif isinstance(value, float) and not 0.0 <= value <= 1.0:
                raise ConfigError(f"{item.name} = {value:g}: a share must be 0 to 1")
        for name, weight in self.maps.items():
            if name not in MAPS or weight < 0.0:
                raise ConfigError(f"maps.{name} = {weight:g}: known are {', '.join(MAPS)}, from 0")
        if not sum(self.maps.values()) > 0.0:
            raise ConfigError("maps: none has a weight above 0")


def family_of(settings: dict[str, Any]) -> FamilyConfig:
    """Return a family from settings that were checked when they were read."""
    ranges: dict[str, Any] = {
        k: tuple(map(float, v)) if isinstance(v, list) else v for k, v in settings.items()
    }
    return FamilyConfig(**ranges)
