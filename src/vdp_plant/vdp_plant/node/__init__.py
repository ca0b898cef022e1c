"""ROS node of the plant: ``theta`` in, ``state`` and ``ground_truth`` out, at three paces."""

from __future__ import annotations

from typing import Any

from koop_core.config.parameter import ListenersConfig
from koop_node.node.managed import Entities, ManagedNode
from vdp_plant.config import PaceConfig, PlantConfig
from vdp_plant.node.base import PlantRun
from vdp_plant.node.lockstep import LockstepRun
from vdp_plant.node.timed import TimedRun
from vdp_plant.stage import due, step_next


class PlantNode(ManagedNode[PlantRun]):
    """Simulates the plant step by step and publishes its corrupted state."""

    configs = (PlantConfig, PaceConfig, ListenersConfig)
    stage, due = step_next, due

    def __init__(self, name: str = "vdp_plant", **options: Any) -> None:
        super().__init__(name, _make_run, **options)


def _make_run(node: PlantNode, entities: Entities) -> PlantRun:
    lockstep = node.parameters[PaceConfig].pace == "lockstep"
    return LockstepRun(node) if lockstep else TimedRun(node)
