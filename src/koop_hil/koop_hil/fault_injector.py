"""The cable between a plant and its controller, on which faults are injected while a run goes on.

``rig/state`` comes out as ``state``, ``theta`` as ``rig/theta``. The parameters ``state_fault`` and
``theta_fault`` say what is wrong with either, also while it runs:

    ros2 param set /fault_injector state_fault "delayed delay=0.1 jitter=0.02"
"""

from __future__ import annotations

import time
from array import array
from dataclasses import dataclass
from typing import Any

from koop_msgs.msg import ControlInput, MeasuredState
from rclpy.publisher import Publisher

from koop_core.config.parameter import ListenersConfig, Settings, parameter
from koop_hil.faults import Channel, parse
from koop_node.node.graph import listeners_of
from koop_node.node.main import run
from koop_node.node.managed import Entities, ManagedNode, Run
from koop_node.node.qos import RELIABLE
from koop_node.process.ending import end_process

PERIOD = 0.001  # [s] between looks for delayed messages that are due


@dataclass(frozen=True)
class FaultInjectorConfig(Settings):
    """Faults of the cable."""

    state_fault: str = parameter("ok", "fault on the sensors, as koop_hil.faults names them")
    theta_fault: str = parameter("ok", "fault on the actuator")
    time_scale: float = parameter(
        1.0, "simulated per real time: delays are simulated time", low=1e-3, high=1e3
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        parse(self.state_fault)
        parse(self.theta_fault)


class FaultInjectorRun(Run):
    """The cable, with what is on its way."""

    def __init__(self, node: FaultInjectorNode, entities: Entities) -> None:
        config = node.parameters[FaultInjectorConfig]
        self._node = node
        self._scale = config.time_scale
        self._channels = {"state": Channel(0), "theta": Channel(1)}
        self._outlets: dict[str, Publisher] = {}
        self._count = 0
        self._timer = entities.timer(PERIOD, self._flush)
        self._timer.cancel()
        self.parameters_changed(set())

    def activate(self, entities: Entities) -> None:
        follower, _ = listeners_of(self._node.parameters[ListenersConfig].listeners, "loop")
        self._outlets = {
            "state": entities.publisher(MeasuredState, "state", RELIABLE),
            "theta": entities.publisher(ControlInput, "rig/theta", RELIABLE),
        }
        entities.subscription(ControlInput, "theta", self._on_theta, RELIABLE)
        entities.when_heard(
            {self._outlets["state"]: follower},
            lambda: entities.subscription(MeasuredState, "rig/state", self._on_state, RELIABLE),
        )

    def deactivate(self) -> None:
        self._outlets = {}

    def parameters_changed(self, names: set[str]) -> None:
        config = self._node.parameters[FaultInjectorConfig]
        for name, text in (("state", config.state_fault), ("theta", config.theta_fault)):
            self._channels[name].fault = parse(text)
        if any(channel.fault.name == "delayed" for channel in self._channels.values()):
            self._timer.restart()

    def samples(self) -> int:
        return self._count

    def _on_state(self, message: MeasuredState) -> None:
        self._count += 1
        self._pass_on("state", message, message.x.tolist())

    def _on_theta(self, message: ControlInput) -> None:
        self._pass_on("theta", message, message.theta.tolist())

    def _pass_on(self, name: str, message: Any, values: list[float]) -> None:
        self._channels[name].push(time.monotonic() * self._scale, message, values)
        self._flush()

    def _flush(self) -> None:
        now = time.monotonic() * self._scale
        for name, channel in self._channels.items():
            for message, values in channel.pop(now):
                if name == "state":
                    message.x = array("d", values)
                elif values:
                    message.theta = array("d", values)
                if self._outlets:
                    self._outlets[name].publish(message)


class FaultInjectorNode(ManagedNode[FaultInjectorRun]):
    """Passes messages on, each through a channel with a fault."""

    configs = (FaultInjectorConfig, ListenersConfig)

    def __init__(self, name: str = "fault_injector", **options: Any) -> None:
        super().__init__(name, FaultInjectorRun, **options)


if __name__ == "__main__":
    end_process(run(FaultInjectorNode))
