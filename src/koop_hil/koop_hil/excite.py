"""The rig of a scenario, excited as any rig is: the data to identify a model from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from koop_bringup.live.process import START_TIMEOUT
from koop_commission.stages import excite
from koop_commission.stages.session import Watch
from koop_hil.processes import Processes
from koop_hil.scenario import Scenario
from koop_hil.supervisor import refuse_dead
from koop_loop.parameters import names_of
from koop_node.client.alone import alone
from koop_tune.rig import rig_file
from koop_tune.rig.rig_file import STATE_TYPE, THETA, THETA_TYPE, RigFile
from relay_esc.config import EscConfig

RATE = 1.0  # [1/s] of theta: what the actuators of the rigs follow


def rig_of(scenario: Scenario, time: float) -> RigFile:
    """Return the rig of a scenario, for an excitation of some time [s]."""
    given = scenario.parameters.get("relay_esc", {})
    known = names_of([EscConfig])
    start = scenario.setting.theta_initial
    esc = EscConfig(**{n: v for n, v in given.items() if n in known} | {"theta_initial": start})
    lifter = scenario.parameters.get("koopman_lifter", {})
    topic = esc.command_topic
    return RigFile(
        measured=lifter.get("input_fields", "/state:x[0],x[1]"),
        measured_type=lifter.get("input_type", STATE_TYPE),
        command=f"{topic}:{esc.command_field}" if topic else f"{THETA}:theta",
        command_type=esc.command_type if topic else THETA_TYPE,
        dt=esc.dt,
        theta_min=esc.theta_min,
        theta_max=esc.theta_max,
        theta_rate=esc.rate_limit or RATE,
        theta_start=start,
        theta_safe=start,
        time=time,
        pace=scenario.setting.time_scale,
    )


def record_excitation(scenario: Scenario, folder: Path, time: float) -> str:
    """Run the scenario's plant, excite it, and return what that came to, in words.

    Its plant, time scale and seed are used; its events and limits are not. The rig file lies
    beside the recordings.

    Raises
    ------
    koop_core.errors.LiveError
        If the plant or a node ends, or another loop runs on the domain.
    """
    rig = rig_of(scenario, time)
    # a rig waits for nobody, as a plant in lockstep would
    scenario = replace(scenario, setting=replace(scenario.setting, pace="scaled"))
    with alone(topics=["state", "ground_truth"]):
        pass  # nobody speaks for the plant that is started now
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "rig.yaml").exists():
        rig_file.write(rig, folder / "rig.yaml")
    with Processes(folder, scenario, controlled=False) as processes:
        watch = Watch(None, lambda: refuse_dead(processes), START_TIMEOUT)
        progress = excite.excite(rig, folder, watch, scenario.setting.seed)
    return excite.describe_result(rig, folder, progress)
