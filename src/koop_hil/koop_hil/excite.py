"""Moves the knob of a rig while a recorder listens: the data to identify a model from."""

from __future__ import annotations

import random
import time
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from koop_bag.bag.reader import BagReader
from koop_hil.processes import Processes
from koop_hil.run import BAR
from koop_hil.scenario import Scenario
from koop_hil.supervisor import refuse_dead, refuse_others, wait_until
from koop_hil.verdict import LEAST
from koop_lab.errors import LiveError
from koop_lab.live.loop import Monitor
from vdp_plant.config import PlantConfig

HOLD = 20.0  # [s] that theta stays, long enough for the limit cycle of that theta
PERIOD = 0.05  # [s] between two commands
PUBLISHERS = {"state": 1, "cost": 0, "theta": 1, "ground_truth": 1}


@dataclass(frozen=True)
class Excitation:
    """A recording to identify a model from, and how much simulated time [s] it holds."""

    bag: Path
    seconds: float


def excite(
    scenario: Scenario, folder: Path, low: float, high: float, duration: float
) -> Excitation:
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

    Raises
    ------
    LiveError
        If a process ends, another loop runs on the domain, or less than 30 % was recorded.
    """
    monitor = Monitor()
    try:
        with Processes(folder, scenario, controlled=False) as processes:
            publisher = monitor.theta_publisher("theta")
            wait_until(
                lambda: publisher.get_subscription_count() > 0 < monitor.count_publishers("state"),
                monitor,
                processes,
            )
            scale, rng = scenario.setting.time_scale, random.Random(scenario.setting.seed)
            started, theta, changed = time.monotonic(), rng.uniform(low, high), 0.0
            with tqdm(
                total=duration, desc=scenario.name, bar_format=BAR, leave=False, disable=None
            ) as bar:
                while (t := (time.monotonic() - started) * scale) < duration:
                    refuse_dead(processes)
                    refuse_others(monitor, PUBLISHERS)
                    if t - changed > HOLD:
                        changed, theta = t, rng.uniform(low, high)
                        bar.n = t
                        bar.set_postfix_str(f"theta {theta:+.2f}")
                    monitor.publish_theta(publisher, theta)
                    monitor.spin(PERIOD)
    finally:
        monitor.close()
    for name, code in processes.exit_codes:
        if code != 0:
            raise LiveError(f"{name} ended with exit code {code}: see {processes.logs}")
    with BagReader(folder / "bag") as reader:
        steps = {topic.name: topic.count for topic in reader.topics}.get("/state", 0)
    seconds = steps * PlantConfig().dt
    if seconds < LEAST * duration:
        raise LiveError(f"only {seconds:g} of {duration:g} s were recorded: see {processes.logs}")
    return Excitation(folder / "bag", seconds)
