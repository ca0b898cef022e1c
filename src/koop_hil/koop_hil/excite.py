"""Moves the knob of a rig while a recorder listens: the data to identify a model from."""

from __future__ import annotations

import random
import sys
import time
from pathlib import Path

from koop_hil.processes import Processes
from koop_hil.scenario import Scenario
from koop_lab.live.loop import START_TIMEOUT, LiveError, Monitor

HOLD = 20.0  # [s] that theta stays, long enough for the limit cycle of that theta
PERIOD = 0.05  # [s] between two commands


def excite(scenario: Scenario, folder: Path, low: float, high: float, duration: float) -> Path:
    """Run the scenario's plant without a controller, theta uniform in [low, high] for each hold.

    Parameters
    ----------
    scenario : Scenario
        Its plant, pace and seed are used; its events and limits are not.
    folder : Path
        Of the recording.
    low, high : float
        Range of theta.
    duration : float
        Simulated time [s].

    Returns
    -------
    Path
        The bag.
    """
    scale, rng = scenario.setting.time_scale, random.Random(scenario.setting.seed)
    monitor = Monitor()
    try:
        with Processes(folder, scenario, controlled=False) as processes:
            publisher = monitor.theta_publisher("theta")
            deadline = time.monotonic() + START_TIMEOUT
            while not publisher.get_subscription_count() or monitor.other_loops() == 0:
                monitor.spin(0.05)
                if processes.dead() or time.monotonic() > deadline:
                    raise LiveError(f"the plant did not start: see {folder}/logs")
            started, theta, changed = time.monotonic(), rng.uniform(low, high), 0.0
            while (t := (time.monotonic() - started) * scale) < duration:
                if t - changed > HOLD:
                    changed, theta = t, rng.uniform(low, high)
                    if sys.stderr.isatty():
                        print(f"\r{t:.0f} of {duration:.0f} s ", end="", file=sys.stderr)
                monitor.publish_theta(publisher, theta)
                monitor.spin(PERIOD)
    finally:
        monitor.close()
    return folder / "bag"
