"""``koop tune``: from what ``koop excite`` recorded to a controller."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from koop_guard.note import note_of
from koop_tune.excitation import progress
from koop_tune.folder import TUNED
from koop_tune.rig import rig_file
from koop_tune.search.settings import TuningSettings


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser(
        "tune",
        description="Chooses the cost and every constant of the controller from a recording of "
        "'koop excite', with a reason for each and a prediction: the closed loop is simulated, "
        "with the nodes' own kernels, on models of the rig drawn from the recording. Exit code 1 "
        "if the recording shows no optimum; the message then says what to record next.",
    )
    parser.add_argument("rig", metavar="RIG.YAML", help="of 'koop commission --new'")
    parser.add_argument(
        "folders", nargs="+", type=Path, metavar="FOLDER",
        help="of 'koop excite', or a bag in which theta is held at several values",
    )  # fmt: skip
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder of the results (default: FOLDER/tuned)"
    )
    parser.add_argument(
        "--effort", type=float, default=1.0, metavar="X",
        help="search budget (default: 1, about a minute on two cores)",
    )  # fmt: skip
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 1 if there is no optimum."""
    from koop_commission.report import try_report  # slow to import
    from koop_tune.tune_folders import tune_folders

    folder = args.folders[0]
    out = args.out or folder / TUNED
    settings = TuningSettings(effort=args.effort)
    tuned = tune_folders(rig_file.read(args.rig), args.folders, out, settings, note_of(args.rig))
    if args.out is None and (folder / progress.NAME).exists():
        print(try_report(folder))
    if tuned:
        print(f"now: ./koop verify {args.rig} {folder}" if args.out is None else
              f"now: ./koop up {out}")  # fmt: skip
    return 0 if tuned else 1
