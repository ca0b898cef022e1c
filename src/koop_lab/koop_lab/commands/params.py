"""``koop params``: an annotated parameter file, to be changed for a rig."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from koop_core.config.parameter import ConfigError
from koop_tune.result.parameter_text import KNOWN, OF_A_RIG, annotated


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser("params")
    parser.add_argument(
        "nodes", nargs="*", metavar="NODE",
        help=f"of {', '.join(KNOWN)}; default: {' '.join(OF_A_RIG)}, for a rig as the plant",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, metavar="FILE", help="write there, not to stdout")
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code."""
    text = annotated(args.nodes or OF_A_RIG)
    if args.out is None:
        print(text, end="")
        return 0
    try:
        with open(args.out, "x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise ConfigError(f"{args.out} is there already: choose another --out") from None
    print(f"written to {args.out}")
    return 0
