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
        description="Runs the experiments offline and writes report.html and tables/*.csv. The "
        "same command resumes a study that was stopped.",
    )
    parser.add_argument(
        "names", nargs="*", metavar="NAME",
        help="such as modes or robustness, of experiments/, or a file of your own (default: "
        "all of experiments/)",
    )  # fmt: skip
    parser.add_argument("--quick", action="store_true", help="a small version, within minutes")
    parser.add_argument(
        "--out", type=Path, metavar="DIR",
        help="where the report and the intermediate results go "
        "(default recordings/study, with --quick recordings/study-quick)",
    )  # fmt: skip
    parser.add_argument(
        "--processes", type=int, default=len(os.sched_getaffinity(0)), metavar="N",
        help="processes at work (default: one for each processor that this one may use)",
    )  # fmt: skip
    parser.add_argument(
        "--scheduler", default="", metavar="ADDRESS",
        help="compute on the workers of the Dask scheduler there, such as tcp://HOST:8786, in "
        "place of processes of this machine; the same results. 'dask scheduler' and 'dask worker "
        "ADDRESS --nthreads 1' in a ./koop shell of the same commit start them",
    )  # fmt: skip
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code."""
    from koop_study import session  # SciPy and Matplotlib: not for every koop command

    return session.run(args)
