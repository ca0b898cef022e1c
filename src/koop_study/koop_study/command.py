"""``koop study``: run the experiments, write the report."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser(
        "study",
        description="Runs every experiment file of a folder offline and writes report.html, "
        "tables/*.csv. A study that was stopped goes on where it was.",
    )
    parser.add_argument(
        "kinds", nargs="*", metavar="KIND",
        help="some kinds of experiments only, such as modes, robustness, laws (default all)",
    )  # fmt: skip
    parser.add_argument("--quick", action="store_true", help="a small version, within minutes")
    parser.add_argument(
        "--out", type=Path, metavar="DIR",
        help="where the report and the intermediate results go "
        "(default recordings/study, with --quick recordings/study-quick)",
    )  # fmt: skip
    parser.add_argument(
        "--experiments", type=Path, default=Path("experiments"), metavar="DIR",
        help="folder of experiment files (default experiments)",
    )  # fmt: skip
    parser.add_argument(
        "--rivals", type=Path, metavar="PYTHON",
        help="Python of an environment with requirements/rivals.txt: the experiment 'laws' then "
        "has the laws of other packages too",
    )  # fmt: skip
    parser.add_argument(
        "--processes", type=int, default=os.cpu_count() or 1, metavar="N",
        help="processes at work (default: one a core)",
    )  # fmt: skip
    parser.add_argument(
        "--scheduler", default="", metavar="ADDRESS",
        help="compute on the workers of the Dask scheduler there, such as tcp://HOST:8786, in "
        "place of processes of this machine; the same results. 'dask scheduler' and 'dask worker "
        "ADDRESS --nthreads 1' in a ./koop shell of the same commit start them",
    )  # fmt: skip
    parser.add_argument(
        "--publish", type=Path, metavar="DIR",
        help="write the report there too, without intermediate results",
    )  # fmt: skip
    parser.add_argument(
        "--readme", type=Path, metavar="FILE", help="rewrite the results in this README"
    )
    parser.add_argument(
        "--over-dds",
        action="store_true",
        help="run only the headline runs, with the real nodes in lockstep, and compare them with "
        "the offline loop bit for bit; exit code 1 if one differs",
    )
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code."""
    from koop_study import session  # SciPy and Matplotlib: not for every koop command

    return session.run(args)
