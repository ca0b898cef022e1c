"""Configuration of the server."""

from __future__ import annotations

import re
from dataclasses import dataclass

from koop_core.config.parameter import ConfigError

ADDRESS = "the page: "  # begins the line with its address


@dataclass(frozen=True)
class ViewConfig:
    """Address and access of the server.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If there is no such port, or an origin is none.
    """

    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0: on all of this machine, without encryption."""
    port: int = 8765
    """TCP port; 0: any that is free."""
    operate: bool = False
    """Whether clients with the token, printed at the start, may hold, reset and change the loop."""
    origins: tuple[str, ...] = ()
    """Origins of web pages that may connect besides the server's own."""
    about: str = ""
    """File with a line that is shown beside the loop, such as the stage of a commissioning; it may
    change."""

    def __post_init__(self) -> None:
        if not 0 <= self.port <= 65535:
            raise ConfigError(f"port must be in [0, 65535], not {self.port}")
        for origin in self.origins:
            if not re.fullmatch(r"[a-z][a-z0-9+.-]*://[^/?#\s]+", origin):
                raise ConfigError(f"'{origin}' is not an origin, such as https://app.foxglove.dev")
