"""Plants for the comparison of laws: the paper's or the rigs of the family, with a cost."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from koop_core.config.parameter import ConfigError
from koop_study.family.config import FamilyConfig, family_of
from koop_study.family.scaled import PAPER_OMEGA, PAPER_TIME, ScaledConstants
from koop_study.simulation.case import Case, override

COSTS_OF_RIGS = ("raw", "contrast")


@dataclass(frozen=True)
class LawPlant:
    """A plant with a cost, as an experiment file declares it.

    Attributes
    ----------
    name : str
        Of its table.
    family : bool
        Whether each seed draws a rig; otherwise the paper's plant.
    cost : str
        On the family ``raw`` or ``contrast``, of a recording of the rig; on the paper's plant any.
    duration : float
        Of a run: seconds on the paper's plant, on the family multiples of the rig's time.
    settings : dict
        Of the paper's plant, as in the other experiments, or of the family.
    """

    name: str
    family: bool
    cost: str
    duration: float
    settings: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.family and self.cost not in COSTS_OF_RIGS:
            raise ConfigError(f"cost = {self.cost!r}: on the family raw or contrast")
        if not 0.0 < self.duration <= 1e6:
            raise ConfigError(f"duration = {self.duration:g}: must be above 0 and at most 1e6")

    def rigs(self) -> FamilyConfig:
        """Return the family."""
        return family_of(self.settings)

    def paper_settings(self, constants: ScaledConstants | None = None) -> dict[str, Any]:
        """Return the settings of the paper's loop with some constants."""
        settings: dict[str, Any] = {"cost": self.cost, "duration": self.duration, **self.settings}
        if constants is None:
            return settings
        esc = override(Case(), settings).esc
        lifter = constants.lifter(PAPER_OMEGA, PAPER_TIME)
        command = constants.esc(PAPER_TIME, esc.theta_max - esc.theta_min, esc.dt)
        return {
            **settings,
            **{f"lifter.{name}": value for name, value in lifter.items()},
            **{f"esc.{name}": value for name, value in command.items()},
        }
