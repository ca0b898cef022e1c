"""``koop hil``: run scenarios with faults on the real nodes and judge them."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from koop_bag.recorder.run_folder import default_folder
from koop_core.config.parameter import ConfigError
from koop_hil.run import run
from koop_hil.scenario import find, read, shipped, with_controller
from koop_tune.folder import find_controller


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser("hil")
    parser.add_argument(
        "scenarios", nargs="*", metavar="SCENARIO", help="file, or a name that --list shows"
    )
    parser.add_argument("--all", action="store_true", help="every scenario of the workspace")
    parser.add_argument("--list", action="store_true", help="only name the scenarios")
    parser.add_argument(
        "--controller", type=Path, metavar="FILE",
        help="lifter and controller of every scenario from this parameter file, or from the folder "
        "of 'koop tune' or 'koop commission'",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, metavar="DIR", help="default: recordings/TIME-hil")
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 0 if every scenario passed, 1 if one failed."""
    files = shipped()
    if args.list:
        for path in files:
            print(f"{path.stem:<24}{read(path).setting.description}")
        return 0
    paths = files if args.all else [find(name) for name in args.scenarios]
    if not paths:
        raise ConfigError("name a scenario, or --all; --list shows them")
    scenarios = [read(path) for path in paths]  # a bad file is reported before an hour has passed
    if args.controller is not None:
        file, _ = find_controller(args.controller)
        scenarios = [with_controller(item, file) for item in scenarios]
    out = args.out or default_folder("hil")
    verdicts = []
    for scenario in scenarios:
        verdicts.append(run(scenario, out / scenario.name))
        print(verdicts[-1], flush=True)
        for failure in verdicts[-1].failures:
            print(f"    {failure}", flush=True)
    failed = sum(bool(verdict.failures) for verdict in verdicts)
    skipped = sum(bool(verdict.skipped) for verdict in verdicts)
    passed = f"{len(verdicts) - failed - skipped} passed, {failed} failed, {skipped} skipped"
    print(f"\n{passed}; recordings in {out}/")
    return 1 if failed else 0
