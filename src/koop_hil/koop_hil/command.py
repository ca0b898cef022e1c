"""``koop hil``: run scenarios with faults on the real nodes and judge them."""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from typing import Any

from koop_bag.recorder.run_folder import default_folder
from koop_core.config.parameter import ConfigError
from koop_core.text_table import table
from koop_hil import chaos
from koop_hil.chaos_verdict import judge
from koop_hil.run import run
from koop_hil.scenario import find, read, shipped

CHAOS = "chaos"


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser("hil")
    parser.add_argument(
        "scenarios", nargs="*", metavar="SCENARIO",
        help="file, a name that --list shows, or chaos: faults at random on a loop of its own",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=0, help="chaos: other faults (default: 0)")
    parser.add_argument(
        "--faults", type=int, default=1000, metavar="N", help="chaos: how many (default: 1000)"
    )
    parser.add_argument("--all", action="store_true", help="every scenario of the workspace")
    parser.add_argument("--list", action="store_true", help="only name the scenarios")
    parser.add_argument("--out", type=Path, metavar="DIR", help="default: recordings/TIME-hil")
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 0 if every scenario passed, 1 if one failed."""
    files = shipped()
    if args.list:
        for path in files:
            print(f"{path.stem:<24} {read(path).setting.description}")
        return 0
    if args.scenarios == [CHAOS]:
        return run_chaos(args.out or default_folder(CHAOS), args.seed, args.faults)
    paths = files if args.all else [find(name) for name in args.scenarios]
    if not paths:
        raise ConfigError("name a scenario, or --all; --list shows them")
    scenarios = [read(path) for path in paths]  # a bad file is reported before an hour has passed
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


def run_chaos(folder: Path, seed: int, count: int) -> int:
    """Run the loop through faults at random; returns the exit code: 1 if it failed."""
    chaos.run(folder, seed, count)
    verdict = judge(folder)
    with (folder / "chaos.csv").open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(verdict.table())
    header, *rows = verdict.table()
    print(table(header, rows))
    causes = "; ".join(f"{cause} {count}" for cause, count in verdict.causes.most_common())
    print(f"\ntrips: {causes or 'none'}; the rig's own time-out acted {verdict.own} times")
    for failure in verdict.failures:
        print(f"FAILED: {failure}")
    total, kinds = verdict.faults.total(), len(verdict.faults)
    end = f"{len(verdict.failures)} failures" if verdict.failures else "passed"
    print(
        f"\n{total} faults of {kinds} kinds in {verdict.seconds:.0f} s, in "
        f"{100.0 * verdict.commanded:.0f} % of which the rig was commanded: {end}; all in {folder}/"
    )
    return 1 if verdict.failures else 0
