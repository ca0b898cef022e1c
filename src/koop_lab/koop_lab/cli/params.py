"""``koop params``: an annotated parameter file, to be changed for a rig."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from koop_bag.recorder.config import RECORDER
from koop_bringup.plan import RIG
from koop_loop.parameters import NODES
from koop_node.config import ConfigError, refuse_unknown
from koop_node.describe import parameter_file

KNOWN = {**NODES, **RECORDER, **RIG}
OF_A_RIG = ("koopman_lifter", "relay_esc", "recorder", "rig")
HEAD = """\
# Parameters of the nodes: each with its meaning, what it may be, and its default. Change what your
# rig needs; what you delete stays the default. dt must be the same in every section. Start with
#
#   ./koop up FILE
#   ros2 launch koop_bringup closed_loop.launch.py params:=FILE record:=true
#   ros2 run relay_esc esc --ros-args --params-file FILE
"""


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


def annotated(nodes: Iterable[str]) -> str:
    """Return the file for some nodes.

    Raises
    ------
    koop_node.config.ConfigError
        If there is no such node.
    """
    refuse_unknown(nodes, KNOWN, "node")
    return HEAD + parameter_file({node: KNOWN[node] for node in nodes})
