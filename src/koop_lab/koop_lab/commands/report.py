"""``koop report``: one page about days or months of a loop."""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path
from typing import Any

from koop_core.config.parameter import ConfigError

UNITS = {"s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0, "w": 604800.0}
NAME = "history.html"


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser(
        "report",
        description=f"Writes {NAME}, a page that needs nothing else: amplitude, theta, cost, "
        "health and trips over time, and a sentence for each thing that happened. Read are the "
        "long-term record of a ring, and recordings at full rate where there is none.",
    )
    parser.add_argument(
        "runs", metavar="FOLDER", nargs="+", type=Path,
        help="a run, or a folder that holds the runs of a loop",
    )  # fmt: skip
    parser.add_argument(
        "--since", metavar="TIME",
        help="only so long before the last message: 7d, 12h, 30m",
    )  # fmt: skip
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code."""
    since = parse_span(args.since) if args.since else None
    from koop_lab.history.page import make_page, write_sentences
    from koop_lab.history.read import read_history

    histories = read_history(args.runs, since)
    path = args.runs[0] / NAME
    path.write_text(make_page(histories), encoding="utf-8")
    for history in histories:
        print("\n".join(write_sentences(history)))
    print("".join(f"note: {text}\n" for text in histories[0].damaged), end="", file=sys.stderr)
    print(f"written to {path}")
    return 0


def parse_span(text: str) -> float:
    """Return a duration in seconds, or raise ConfigError.

    >>> parse_span("7d")
    604800.0
    """
    match = re.fullmatch(r"(\d+(?:\.\d+)?)([smhdw])", text.strip())
    if match is None:
        raise ConfigError(f"--since {text}: write a number and its unit, such as 7d, 12h or 30m")
    return float(match[1]) * UNITS[match[2]]
