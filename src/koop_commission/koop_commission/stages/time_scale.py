"""The option ``--time-scale`` of the commands that talk to a rig."""

from __future__ import annotations

import argparse

from koop_core.config.parameter import ConfigError


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the option."""
    parser.add_argument(
        "--time-scale", type=float, default=1.0, metavar="K",
        help="of a simulated rig: its seconds in one second",
    )  # fmt: skip


def words(args: argparse.Namespace) -> str:
    """Return the option as it was given, for a command to be typed again; empty without it.

    >>> words(argparse.Namespace(time_scale=4.0))
    ' --time-scale 4'
    """
    return "" if args.time_scale == 1.0 else f" --time-scale {args.time_scale:g}"


def of(args: argparse.Namespace) -> float:
    """Return what was given.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If it cannot be.
    """
    if not 0.0 < args.time_scale < 1e3:
        raise ConfigError("--time-scale: above 0, below 1000")
    return float(args.time_scale)
