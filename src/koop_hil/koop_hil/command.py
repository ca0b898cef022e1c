"""``koop hil``: run scenarios with faults on the real nodes and judge them."""

from __future__ import annotations

import argparse
import json
import sys
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from koop_bag.errors import BagError
from koop_hil import installed, report
from koop_hil.isolated_host import VERDICT, run_apart
from koop_hil.scenario import Scenario, read
from koop_hil.verdict import Verdict
from koop_node.config import ConfigError
from relay_esc.config import EscConfig

SOAK = 600.0  # [s] from which on the growth of memory and latency means something


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser("hil", help="hardware in the loop: scenarios with faults")
    parser.add_argument(
        "scenarios", nargs="*", metavar="SCENARIO", help="file, or a name that --list shows"
    )
    parser.add_argument("--all", action="store_true", help="every scenario of the workspace")
    parser.add_argument("--list", action="store_true", help="only name the scenarios")
    parser.add_argument("--repeat", type=int, default=1, metavar="N", help="times in a row")
    parser.add_argument("--out", type=Path, metavar="DIR", help="default: recordings/TIME-hil")
    parser.add_argument("--junit", type=Path, metavar="FILE", help="also write JUnit XML here")
    parser.add_argument("--table", type=Path, metavar="FILE", help="also write a Markdown table")
    parser.add_argument(
        "--exercise",
        type=float,
        metavar="S",
        help="no controller: move theta at random for this time, to record training data",
    )
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 0 if every scenario passed, 1 if one failed."""
    if args.repeat < 1:
        raise ConfigError("--repeat: at least 1")
    known = scenario_files()
    if args.list:
        for path in known:
            print(f"{path.stem:<24}{read(path).setting.description}")
        return 0
    paths = known if args.all else [find(name) for name in args.scenarios]
    if not paths:
        raise ConfigError("name a scenario, or --all; --list shows them")
    scenarios = [read(path) for path in paths]  # a bad file is reported before an hour has passed
    stamp = datetime.now(timezone.utc).strftime("%Y%m%dT%H%M%SZ")
    out = args.out or Path("recordings") / f"{stamp}-hil"
    if args.exercise is not None:
        for scenario in scenarios:
            bag = record_exercise(scenario, out / scenario.name, args.exercise)
            print(f"recorded; now 'koop train {bag} --dt 0.005 --out model.npz'")
        return 0
    verdicts = []
    for number in range(args.repeat):
        for scenario in scenarios:
            name = scenario.name if args.repeat == 1 else f"{scenario.name}-{number + 1}"
            verdicts.append(run(scenario, out / name))
            print(report.line(verdicts[-1]), flush=True)
            if scenario.setting.duration >= SOAK:
                print(report.growth(verdicts[-1]), flush=True)
            for failure in verdicts[-1].failures:
                print(f"    {failure}", flush=True)
    if args.junit:
        report.write_junit(verdicts, args.junit)
    if args.table:
        args.table.write_text(report.table(verdicts[-len(scenarios) :]))
    failed = sum(bool(verdict.failures) for verdict in verdicts)
    skipped = sum(bool(verdict.skipped) for verdict in verdicts)
    passed = f"{len(verdicts) - failed - skipped} passed, {failed} failed, {skipped} skipped"
    print(f"\n{passed}; recordings in {out}/")
    return 1 if failed else 0


def scenario_files() -> list[Path]:
    """Return the scenario files that come with the package."""
    return sorted(installed("scenarios").glob("*.yaml"))


def find(name: str) -> Path:
    """Return the file of a scenario.

    Raises
    ------
    ConfigError
        If there is none.
    """
    if Path(name).suffix in (".yaml", ".yml"):
        return Path(name)
    for path in scenario_files():
        if path.stem == name:
            return path
    raise ConfigError(f"no scenario '{name}': 'koop hil --list' shows them")


def record_exercise(scenario: Scenario, folder: Path, duration: float) -> Path:
    """Record a scenario's plant over the controller's range of theta."""
    from koop_hil.excite import exercise

    limits = EscConfig(theta_initial=scenario.setting.theta_initial)
    return exercise(scenario, folder, limits.theta_min, limits.theta_max, duration)


def run(scenario: Scenario, folder: Path) -> Verdict:
    """Run one scenario, judge it and write ``verdict.json`` beside its recording."""
    if (folder / "bag").exists():
        raise ConfigError(f"{folder} holds a recording already: choose another --out")
    folder.mkdir(parents=True, exist_ok=True)
    verdict = (run_apart if scenario.setting.remote else run_here)(scenario, folder)
    (folder / VERDICT).write_text(json.dumps(verdict.as_dict(), indent=1) + "\n")
    return verdict


def run_here(scenario: Scenario, folder: Path) -> Verdict:
    """Run one scenario on the host of this process and judge it."""
    from koop_hil.runner import Supervisor
    from koop_hil.verdict import judge
    from koop_lab.live.loop import LiveError

    def show(t: float, text: str) -> None:
        if sys.stderr.isatty():
            duration = scenario.setting.duration
            print(f"\r{scenario.name}: {t:.0f} of {duration:.0f} s, {text}  ", end="\r",
                  file=sys.stderr)  # fmt: skip

    try:
        record = Supervisor(scenario, folder, show).run()
        return judge(scenario, record, folder / "bag")
    except (LiveError, BagError) as error:  # one bad scenario doesn't end the others
        return Verdict(scenario.name, scenario.setting.description, [], failures=[str(error)])
