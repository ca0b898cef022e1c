"""Moves the knob of a rig while a recorder listens: the data to identify a model from."""

from __future__ import annotations

import random
import time
from pathlib import Path

import numpy as np
from tqdm import tqdm

from koop_bag.bag.columns import read_tables
from koop_bag.bag.reader import BagReader
from koop_hil.processes import Processes
from koop_hil.report import WHOLE
from koop_hil.run import BAR
from koop_hil.scenario import Scenario
from koop_hil.supervisor import refuse_dead, refuse_others, wait_until
from koop_lab.live.monitor import Monitor
from koop_lab.live.process import START_TIMEOUT
from koop_node.alone import alone
from koop_node.errors import LiveError
from vdp_plant.config import PlantConfig

HOLD = 60.0  # [s] that theta stays: rig and detector settle, and some periods are left
LISTENERS = 2  # to theta: the plant and the recorder
LOOK_PERIOD = 0.2  # [s] between looks at the processes
PUBLISHERS = {"state": 1, "cost": 0, "theta": 1, "ground_truth": 1}


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

    Raises
    ------
    LiveError
        If a process ends, another loop runs on the domain, no more states come, or theta is known
        for a part only of what was recorded.
    """
    from koop_msgs.msg import ControlInput, MeasuredState

    from koop_node.qos import RELIABLE

    dt = PlantConfig().dt
    rng = random.Random(scenario.setting.seed)
    chosen = [rng.uniform(low, high) for _ in range(int(duration // HOLD) + 2)]
    reached = 0  # step

    def theta(step: int) -> float:
        nonlocal reached
        reached = step
        return chosen[min(int(step * dt // HOLD), len(chosen) - 1)]

    with alone(topics=PUBLISHERS), Monitor() as monitor:
        publisher = monitor.node.create_publisher(ControlInput, "theta", RELIABLE)

        def answer(state: MeasuredState) -> None:
            publisher.publish(
                ControlInput(header=state.header, step=state.step, theta=theta(state.step))
            )

        with (
            Processes(folder, scenario, controlled=False) as processes,
            tqdm(
                total=duration, desc=scenario.name, bar_format=BAR, leave=False, disable=None
            ) as bar,
        ):
            # as in the nodes: who listens to the state tells the plant that all downstream is ready
            wait_until(lambda: publisher.get_subscription_count() >= LISTENERS, monitor, processes)
            monitor.node.create_subscription(MeasuredState, "state", answer, RELIABLE)
            wait_until(lambda: reached > 0, monitor, processes)
            looked, heard, last = 0.0, time.monotonic(), 0
            while (t := reached * dt) < duration:
                monitor.spin(LOOK_PERIOD)
                if (now := time.monotonic()) < looked + LOOK_PERIOD:
                    continue
                looked = now
                refuse_dead(processes)
                refuse_others(monitor, PUBLISHERS)
                if reached != last:
                    heard, last = now, reached
                elif now > heard + START_TIMEOUT:
                    raise LiveError(f"no state for {START_TIMEOUT:g} s: see {processes.logs}")
                bar.n = t
                bar.set_postfix_str(f"theta {theta(reached):+.2f}")
    if processes.failures:
        raise LiveError(processes.failures[0])
    bag = folder / "bag"
    states, answered = count_answers(bag)
    if answered < WHOLE * duration / dt:
        raise LiveError(
            f"{bag}: {states} states and a theta for {answered} of them were recorded, which is "
            f"{answered * dt:.0f} of {duration:.0f} s: something slows the recorder, or the domain "
            f"is shared; see {processes.logs}"
        )
    return bag


def count_answers(bag: Path) -> tuple[int, int]:
    """Return how many states a bag holds, and for how many of them a theta."""
    with BagReader(bag) as reader:
        recorded = {topic.name for topic in reader.topics if topic.count}
        if not recorded >= {"/state", "/theta"}:
            return 0, 0
        tables = read_tables(reader, {"/state": ["step"], "/theta": ["step"]})
    states, thetas = (np.unique(tables[topic]["step"]) for topic in ("/state", "/theta"))
    return states.size, np.intersect1d(states, thetas).size
