"""The part of the plant's state that the lifter receives, with its delays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import ConfigError, parameter, validate
from koop_loop.training import STATE_NAMES
from koopman_lifter.delays import Delays

CHANNELS = {"both": (0, 1), "x": (0,), "y": (1,)}


@dataclass(frozen=True)
class SensingConfig:
    """Measured states and delays; the defaults are the paper's: both states, no delays.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If a value has the wrong type or is out of range.
    """

    channels: str = parameter("both", "measured states", choices=tuple(CHANNELS))
    delays: int = parameter(1, "samples of each of them that make up the state", low=1, high=64)
    spacing: float = parameter(
        0.0, "time between two of these samples", unit="s", low=0.0, high=100.0
    )

    def __post_init__(self) -> None:
        validate(self)
        if (self.delays > 1) != (self.spacing > 0.0):
            raise ConfigError("delays and spacing: both or none; one sample has no spacing")

    @property
    def indices(self) -> NDArray[np.int64]:
        """Positions of the measured channels in the plant's state."""
        return np.array(CHANNELS[self.channels], dtype=np.int64)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the measured channels."""
        return tuple(STATE_NAMES[i] for i in CHANNELS[self.channels])

    def embedding(self, dt: float) -> Delays:
        """Return the delays at a sampling time [s]."""
        return Delays.spaced(len(CHANNELS[self.channels]), self.delays, self.spacing, dt)
