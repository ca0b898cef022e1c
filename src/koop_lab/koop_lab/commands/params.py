"""``koop params``: an annotated parameter file, to be changed for a rig."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from koop_guard.note import note_of
from koop_tune.result.parameter_text import KNOWN, OF_A_RIG, annotated, list_untuned
from koop_tune.rig.rig_file import read


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser("params")
    parser.add_argument(
        "nodes", nargs="*", metavar="NODE",
        help=f"of {', '.join(KNOWN)}; default: {' '.join(OF_A_RIG)}, for a rig as the plant",
    )  # fmt: skip
    parser.add_argument(
        "--rig", metavar="FILE", type=Path,
        help="rig file, of one knob or several, whose values to fill in; with the guard",
    )  # fmt: skip
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code."""
    listed = list_untuned(read(args.rig), note_of(args.rig)) if args.rig else {}
    print(annotated(args.nodes or dict.fromkeys((*OF_A_RIG, *listed)), listed), end="")
    return 0
