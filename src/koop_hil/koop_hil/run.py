"""Runs one scenario and judges it.

As a program it runs the scenario that a folder holds: what the process of an isolated host does.
"""

from __future__ import annotations

import json
import pickle
import signal
import sys
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path

from tqdm import tqdm

from koop_bag.errors import BagError
from koop_core.config.parameter import ConfigError
from koop_core.errors import LiveError
from koop_hil import supervisor
from koop_hil.hosts import HostsError, call_isolated
from koop_hil.scenario import Scenario
from koop_hil.verdict import Verdict, judge
from koop_node.process.ending import end_process
from koop_node.process.lifeline import end_with_parent

PICKLE = "hosts.pickle"  # the scenario for another process, then its verdict
PACKAGES = {"jsbsim": ("jsbsim", "JSBSim"), "inverter": ("dpsimpy", "DPsim")}  # of others
INSTALL = "pip install --no-deps -r requirements/plants.txt"
BAR = "{desc:<24} {percentage:3.0f}% |{bar}| {n:.0f}/{total:.0f} s{postfix}"


def run(scenario: Scenario, folder: Path) -> Verdict:
    """Run one scenario, judge it and write ``verdict.json`` beside its recording.

    Raises ConfigError if the folder holds a recording already.
    """
    if (folder / "bag").exists():
        raise ConfigError(f"{folder} holds a recording already: choose another --out")
    folder.mkdir(parents=True, exist_ok=True)
    package, name = PACKAGES.get(scenario.setting.plant, ("sys", ""))
    if find_spec(package) is None:
        why = f"{name} is not installed: {INSTALL}"
        return Verdict(scenario.name, scenario.setting.description, [], skipped=why)
    verdict = (_run_isolated if scenario.setting.remote else run_here)(scenario, folder)
    content = {**asdict(verdict), "passed": verdict.passed}
    (folder / "verdict.json").write_text(json.dumps(content, indent=1) + "\n")
    return verdict


def run_here(scenario: Scenario, folder: Path) -> Verdict:
    """Run one scenario on the host of this process and judge it."""
    duration = scenario.setting.duration
    try:
        with tqdm(
            total=duration, desc=scenario.name, bar_format=BAR, leave=False, disable=None
        ) as bar:

            def show(t: float, text: str) -> None:
                bar.n = min(t, duration)
                bar.set_postfix_str(text)

            record = supervisor.run(scenario, folder, show)
        return judge(scenario, record, folder / "bag")
    except (LiveError, BagError) as error:  # one bad scenario doesn't end the others
        return Verdict(scenario.name, scenario.setting.description, [], failures=[str(error)])


def _run_isolated(scenario: Scenario, folder: Path) -> Verdict:
    """Run and judge a scenario with two hosts; it is skipped where they cannot be made."""
    (folder / PICKLE).write_bytes(pickle.dumps(scenario))
    empty = Verdict(scenario.name, scenario.setting.description, [])
    try:
        code = call_isolated([sys.executable, "-m", __name__, str(folder)])
    except HostsError as error:
        empty.skipped = str(error)
        return empty
    made = (folder / PICKLE).read_bytes()
    (folder / PICKLE).unlink()
    if code != 0:
        empty.failures = [f"the process of the first host ended with exit code {code}"]
        return empty
    verdict: Verdict = pickle.loads(made)
    return verdict


def main(folder: Path) -> int:
    """Run the scenario of a folder; returns the exit code."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    end_with_parent()
    scenario: Scenario = pickle.loads((folder / PICKLE).read_bytes())
    try:
        (folder / PICKLE).write_bytes(pickle.dumps(run_here(scenario, folder)))
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    end_process(main(Path(sys.argv[1])))
