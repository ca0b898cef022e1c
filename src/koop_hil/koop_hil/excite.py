"""The rig of a scenario, excited as any rig is: the data to identify a model from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from koop_hil.processes import Processes
from koop_hil.scenario import Scenario
from koop_hil.supervisor import refuse_dead
from koop_lab.commission import excite, rig_file
from koop_lab.commission.rig_file import RigFile
from koop_lab.live.process import START_TIMEOUT
from koop_node.alone import alone
from relay_esc.config import EscConfig
from vdp_plant.config import PlantConfig

RATE = 1.0  # [1/s] of theta: what the actuators of the rigs follow


def rig_of(scenario: Scenario, time: float) -> RigFile:
    """Return the rig of a scenario, for an excitation of some time [s]."""
    limits = EscConfig(theta_initial=scenario.setting.theta_initial)
    own = scenario.parameters.get("koopman_lifter", {}).get("input_fields", "")
    return RigFile(
        measured=own or "/state:x[0],x[1]",
        measured_type="koop_msgs/msg/MeasuredState",
        command="/theta:theta",
        command_type="koop_msgs/msg/ControlInput",
        dt=PlantConfig().dt,
        theta_min=limits.theta_min,
        theta_max=limits.theta_max,
        theta_rate=RATE,
        theta_start=limits.theta_initial,
        theta_safe=limits.theta_initial,
        time=time,
    )


def record_excitation(scenario: Scenario, folder: Path, time: float) -> str:
    """Run the scenario's plant, excite it, and return what that came to, in words.

    Its plant, time scale and seed are used; its events and limits are not. The rig file lies
    beside the recordings.

    Raises
    ------
    koop_node.errors.LiveError
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
        result = excite.excite(
            rig, folder, scenario.setting.time_scale, scenario.setting.seed,
            check=lambda: refuse_dead(processes), patience=START_TIMEOUT,
        )  # fmt: skip
    return excite.ending(rig, folder, result)
