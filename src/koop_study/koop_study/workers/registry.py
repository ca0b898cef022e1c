"""The functions that worker processes run, by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from koop_study.laws import run
from koop_study.simulation import work


def commission_plant(**arguments: Any) -> Any:
    """Do :func:`koop_study.commissioning.work.commission_plant`, which no other work imports."""
    from koop_study.commissioning.work import commission_plant as commission

    return commission(**arguments)


WORK: dict[str, Callable[..., Any]] = {
    **work.WORK,
    **run.WORK,
    "commission_plant": commission_plant,
}


def check(name: str, arguments: dict[str, Any]) -> None:
    """Raise ConfigError if a work's settings cannot be used, before anything is computed."""
    if name in work.WORK:  # the laws' are checked where they are read
        work.check(name, arguments)
