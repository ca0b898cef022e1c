"""The stages of a loop in lockstep whose nodes share a process, as one kernel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from koop_core.borrowed import borrowed
from koop_core.kernels import njit
from koop_core.port import IDLE, MORE
from koop_core.wakeup import Wakeup, wait
from koop_node.node.managed import ManagedNode
from koop_node.node.stages import Stages
from koopman_lifter import stage as lifter_stage
from koopman_lifter.node import LifterNode
from koopman_lifter.stage import LifterProgress, LifterStage
from relay_esc import stage as controller_stage
from relay_esc.node import EscNode
from relay_esc.stage import ControllerProgress, ControllerStage
from vdp_plant import stage as plant_stage
from vdp_plant.config import PaceConfig
from vdp_plant.node import PlantNode
from vdp_plant.stage import PlantProgress, PlantStage


@njit(nogil=True)
def run(
    most: int, wakeup: Wakeup,
    lifter: LifterStage, controller: ControllerStage, plant: PlantStage,
    lifted: LifterProgress, controlled: ControllerProgress, advanced: PlantProgress,
) -> tuple[
    tuple[int, LifterProgress], tuple[int, ControllerProgress], tuple[int, PlantProgress]
]:  # fmt: skip
    """Run the loop until a node has a reason to stop, at most so many steps."""
    one = two = three = MORE
    lent = borrowed(lifter), borrowed(controller), borrowed(plant)
    for _ in range(most):
        one, lifted = lifter_stage.answer_next(lent[0], lifted)
        two, controlled = controller_stage.answer_next(lent[1], controlled)
        three, advanced = plant_stage.step_next(lent[2], advanced)
        reason = max(one, two, three)
        if reason == IDLE:
            reason = one = wait(wakeup)
        if reason != MORE:
            break
    return (one, lifted), (two, controlled), (three, advanced)


def find(nodes: Sequence[ManagedNode[Any]]) -> list[Stages]:
    """Return the loops in lockstep that nodes of one process make up, one a namespace."""
    loops = []
    for namespace in dict.fromkeys(node.get_namespace() for node in nodes):
        there = [
            [node for node in nodes if isinstance(node, kind) and node.get_namespace() == namespace]
            for kind in (LifterNode, EscNode, PlantNode)
        ]
        if all(len(found) == 1 for found in there):
            lifter, controller, plant = (found[0] for found in there)
            if plant.parameters[PaceConfig].pace == "lockstep":
                loops.append(Stages(run, [lifter, controller, plant]))
    return loops
