"""Seeds of an experiment."""

from __future__ import annotations

from dataclasses import dataclass

from koop_core.config.parameter import ConfigError


@dataclass(frozen=True)
class Seeds:
    """``count`` consecutive seeds from ``first`` on."""

    first: int
    count: int

    def __post_init__(self) -> None:
        if self.first < 0 or not 1 <= self.count <= 100_000:
            raise ConfigError(f"seeds from {self.first}, {self.count} of them: need at least one")

    def list(self) -> list[int]:
        """Return the seeds."""
        return [*range(self.first, self.first + self.count)]
