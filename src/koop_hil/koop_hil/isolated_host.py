"""Runs a scenario with two hosts in a process that has a host of its own, and so have its nodes."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path
from types import FrameType

from koop_hil import scenario as scenarios
from koop_hil.hosts import BOUND, HostsError, entrance, environment
from koop_hil.scenario import Scenario
from koop_hil.verdict import Verdict

VERDICT = "verdict.json"


def run_apart(scenario: Scenario, folder: Path) -> Verdict:
    """Run and judge a scenario; it is skipped where two hosts cannot be made."""
    try:
        words = entrance()
    except HostsError as error:
        return Verdict(scenario.name, scenario.setting.description, [], skipped=str(error))
    file = folder / f"{scenario.name}.yaml"
    scenarios.write(scenario, file)
    process = subprocess.Popen(
        [*words, *BOUND, sys.executable, "-m", __name__, file, folder],
        env=environment(),
        stdin=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C reaches it once, from here
    )
    try:
        code = process.wait()
    except BaseException:
        process.terminate()
        process.wait()
        raise
    if code != 0:
        said = f"the process of the first host ended with exit code {code}"
        return Verdict(scenario.name, scenario.setting.description, [], failures=[said])
    return Verdict.from_dict(json.loads((folder / VERDICT).read_text()))


def main(file: Path, folder: Path) -> int:
    """Run the scenario here; returns the exit code."""
    from koop_hil.command import run_here

    def on_signal(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, on_signal)
    try:
        verdict = run_here(scenarios.read(file), folder)
    except KeyboardInterrupt:
        return 130
    (folder / VERDICT).write_text(json.dumps(verdict.as_dict()))
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2])))
