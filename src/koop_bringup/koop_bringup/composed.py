"""The stages of the loops whose nodes share a process, as one kernel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from koop_core.borrowed import load, store
from koop_core.kernels import njit
from koop_core.port import MORE
from koop_core.wakeup import Loop, Memory, Reasons
from koop_node.node.managed import ManagedNode
from koop_node.node.stages import Stages
from koopman_lifter import stage as lifter_stage
from koopman_lifter.node import LifterNode
from relay_esc import stage as controller_stage
from relay_esc.node import EscNode
from vdp_plant import stage as plant_stage
from vdp_plant.node import PlantNode


@njit()
def go_on(most: int, memory: Memory, kind: Any, reasons: Reasons) -> float:
    """Go on with a loop; see :func:`koop_core.wakeup.make_run`."""
    one = two = three = MORE
    loop = load(memory, 0, kind)
    lifter, controller, plant = loop.stages
    lifted, controlled, advanced = loop.progress
    for _ in range(most):
        one, lifted = lifter_stage.answer_next(lifter, lifted)
        two, controlled = controller_stage.answer_next(controller, controlled)
        three, advanced = plant_stage.step_next(plant, advanced)
        if max(one, two, three) != MORE:
            break
    reasons[0], reasons[1], reasons[2] = one, two, three
    store(memory, 0, Loop(loop.stages, (lifted, controlled, advanced)))
    return plant_stage.due(advanced)


def find(nodes: Sequence[ManagedNode[Any]]) -> list[Stages]:
    """Return the stages of the loops that nodes of one process make up, one a namespace."""
    loops = []
    for namespace in dict.fromkeys(node.get_namespace() for node in nodes):
        there = [
            [node for node in nodes if isinstance(node, kind) and node.get_namespace() == namespace]
            for kind in (LifterNode, EscNode, PlantNode)
        ]
        if all(len(found) == 1 for found in there):
            loops.append([found[0] for found in there])
    return [Stages(go_on, loops)] if loops else []
