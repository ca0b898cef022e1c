"""Configuration of the server."""

from __future__ import annotations

import re
from dataclasses import dataclass

from koop_core.config.parameter import ConfigError, parameter, validate

ADDRESS = "the page: "  # begins the line with its address


@dataclass(frozen=True)
class ViewConfig:
    """Address and access of the server.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If a value has the wrong type or is out of range.
    """

    host: str = parameter(
        "127.0.0.1",
        "address to listen on; 0.0.0.0: on all of this machine, without encryption",
        read_only=True,
    )
    port: int = parameter(8765, "TCP port; 0: any that is free", low=0, high=65535, read_only=True)
    operate: bool = parameter(
        False,
        "allow clients with the token, printed at the start, to hold, reset and change the loop",
        read_only=True,
    )
    allow_origins: str = parameter(
        "",
        "origins of web pages that may connect besides the server's own, separated by spaces, "
        "such as https://app.foxglove.dev",
        read_only=True,
    )
    about: str = parameter(
        "",
        "file with a line that is shown beside the loop, such as the stage of a commissioning; "
        "it may change",
        read_only=True,
    )

    def __post_init__(self) -> None:
        validate(self)
        for origin in self.origins:
            if not re.fullmatch(r"[a-z][a-z0-9+.-]*://[^/?#\s]+", origin):
                raise ConfigError(
                    f"allow_origins: '{origin}' is not an origin, such as https://app.foxglove.dev"
                )

    @property
    def origins(self) -> tuple[str, ...]:
        """The origins that are allowed."""
        return tuple(self.allow_origins.split())
