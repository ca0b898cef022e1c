"""The functions that worker processes run, by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from koop_study.laws import run
from koop_study.simulation import work

WORK: dict[str, Callable[..., Any]] = {**work.WORK, **run.WORK}


def check(name: str, arguments: dict[str, Any]) -> None:
    """Raise ConfigError if a work's settings cannot be used, before anything is computed."""
    if name in work.WORK:  # the laws' are checked where they are read
        work.check(name, arguments)
