"""The rig's own program, which a parameter file may name. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from koop_core.config.parameter import Settings, parameter
from koop_core.config.program import split_command


@dataclass(frozen=True)
class RigConfig(Settings):
    """The rig itself, as far as it is a program of this machine; no node reads it."""

    command: str = parameter(
        "",
        "program, with its arguments, that is the rig or its driver: started with the loop, ended "
        "with it, and its end ends the loop; empty: you start it yourself",
    )

    def words(self) -> tuple[str, ...]:
        """Return program and arguments; raise ConfigError if the program does not exist."""
        return split_command("rig: command", self.command)


RIG: dict[str, tuple[type, ...]] = {"rig": (RigConfig,)}
