"""A loop in lockstep whose nodes share a process: many steps in one compiled call, over DDS.

What the nodes do with a message that follows on the last one is the same for ever: they take it,
run their kernels, publish the answer. That is compiled, with rcl's own functions; every message
goes through DDS as ever. What is not plain (another layout, a gap, a join, the last step) goes to
the node, in Python, before anything is done with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from koop_core.kernels import njit
from koop_core.port import FAILED, IDLE, MORE
from koop_node.node.managed import ManagedNode
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

MOST = 500  # steps of a call: other messages and timers wait for so long
LIFTER, CONTROLLER, PLANT = range(3)


class Outcome(NamedTuple):
    """Why a call has ended, and at which node; and what the nodes have reached."""

    reason: int
    node: int
    lifter: LifterProgress
    controller: ControllerProgress
    plant: PlantProgress


@njit()
def run(
    most: int,
    lifter: LifterStage, controller: ControllerStage, plant: PlantStage,
    lifted: LifterProgress, controlled: ControllerProgress, advanced: PlantProgress,
) -> Outcome:  # fmt: skip
    """Run the loop until a node has a reason to stop, at most so many steps."""
    for _ in range(most):
        idle = True
        reason, lifted = lifter_stage.answer_next(lifter, lifted)
        if reason != MORE and reason != IDLE:
            return Outcome(reason, LIFTER, lifted, controlled, advanced)
        idle = idle and reason == IDLE
        reason, controlled = controller_stage.answer_next(controller, controlled)
        if reason != MORE and reason != IDLE:
            return Outcome(reason, CONTROLLER, lifted, controlled, advanced)
        idle = idle and reason == IDLE
        reason, advanced = plant_stage.step_next(plant, advanced)
        if reason != MORE and (reason != IDLE or idle):
            return Outcome(reason, PLANT, lifted, controlled, advanced)
    return Outcome(MORE, PLANT, lifted, controlled, advanced)


class LockstepLoop:
    """The three nodes of a loop in one process, lifter, controller and plant."""

    def __init__(self, *nodes: ManagedNode[Any]) -> None:
        self._nodes = nodes
        self._rehearsed = False

    def __call__(self) -> None:
        """Run the loop as far as it goes without Python.

        Raises RuntimeError if rcl cannot publish, as rclpy would.
        """
        runs, stages, progress = [], [], []
        for node in self._nodes:
            lent = node.run and node.run.lend(not self._rehearsed)
            if node.run is None or lent is None:
                return
            runs.append(node.run)
            stages.append(lent[0])
            progress.append(lent[1])
        if not self._rehearsed:  # compiled before the first state: it takes seconds
            run(0, *stages, *progress)
            self._rehearsed = True
            return
        outcome = run(MOST, *stages, *progress)
        for each, before, after in zip(runs, progress, outcome[2:], strict=True):
            each.take_back(before, after)
        if outcome.reason == FAILED:
            raise RuntimeError(f"{self._nodes[outcome.node].get_name()} cannot publish")
        runs[outcome.node].handle(outcome.reason)


def find(nodes: Sequence[ManagedNode[Any]]) -> list[LockstepLoop]:
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
                loops.append(LockstepLoop(lifter, controller, plant))
    return loops
