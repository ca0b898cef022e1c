"""``koop params``: an annotated parameter file, to be changed for a rig."""

from __future__ import annotations

import argparse
from typing import Any

from koop_tune.result.parameter_text import KNOWN, OF_A_RIG, annotated


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser("params")
    parser.add_argument(
        "nodes", nargs="*", metavar="NODE",
        help=f"of {', '.join(KNOWN)}; default: {' '.join(OF_A_RIG)}, for a rig as the plant",
    )  # fmt: skip
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code."""
    print(annotated(args.nodes or OF_A_RIG), end="")
    return 0
