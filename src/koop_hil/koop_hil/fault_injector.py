"""The cable between a plant and its controller, on which faults are injected while a run goes on.

``rig/state`` comes out as ``state``, ``theta`` as ``rig/theta``. The parameters ``state_fault`` and
``theta_fault`` say what is wrong with either, also while it runs:

    ros2 param set /fault_injector state_fault "delayed delay=0.1 jitter=0.02"
"""

from __future__ import annotations

import sys
import time
from array import array
from dataclasses import dataclass
from typing import Any

from koop_msgs.msg import ControlInput, MeasuredState

from koop_hil.faults import Channel, parse
from koop_node.config import NodeConfig, parameter, validate
from koop_node.main import run
from koop_node.managed import RELIABLE, ManagedNode

PERIOD = 0.001  # [s] between looks for delayed messages that are due


@dataclass(frozen=True)
class FaultInjectorConfig:
    """What is wrong with the cable."""

    state_fault: str = parameter("ok", "fault on the sensors, as koop_hil.faults names them")
    theta_fault: str = parameter("ok", "fault on the actuator")
    time_scale: float = parameter(
        1.0, "simulated per real time: delays are simulated time", low=1e-3, high=1e3
    )
    seed: int = parameter(0, "seed of random faults", low=0, high=2**31 - 1, read_only=True)

    def __post_init__(self) -> None:
        validate(self)
        parse(self.state_fault)
        parse(self.theta_fault)


class FaultInjectorNode(ManagedNode):
    """Passes messages on, each through a channel with a fault."""

    def __init__(self) -> None:
        super().__init__("fault_injector", FaultInjectorConfig)
        self._count = 0

    def configure(self) -> None:
        config = self.parameters[FaultInjectorConfig]
        self._scale = config.time_scale
        self._channels = {"state": Channel(config.seed), "theta": Channel(config.seed + 1)}
        self._publishers_ = {
            "state": self.create_publisher(MeasuredState, "state", RELIABLE),
            "theta": self.create_publisher(ControlInput, "rig/theta", RELIABLE),
        }
        self._timer = self.steady_timer(PERIOD, self._flush)
        self._timer.cancel()
        self.parameters_changed(set())

    def activate(self) -> None:
        recorders = self.parameters[NodeConfig].recorders
        self.create_subscription(ControlInput, "theta", self._on_theta, RELIABLE)
        self.when_matched({self._publishers_["state"]: 1 + recorders}, self._listen)

    def parameters_changed(self, names: set[str]) -> None:
        config = self.parameters[FaultInjectorConfig]
        if self.lifecycle_state == "unconfigured":
            return
        for name, text in (("state", config.state_fault), ("theta", config.theta_fault)):
            self._channels[name].fault = parse(text)
        delayed = any(channel.fault.name == "delayed" for channel in self._channels.values())
        if delayed:
            self._timer.reset()

    def samples(self) -> int:
        return self._count

    def _listen(self) -> None:
        self.create_subscription(MeasuredState, "rig/state", self._on_state, RELIABLE)

    def _on_state(self, message: MeasuredState) -> None:
        self._count += 1
        self._pass_on("state", message, message.x.tolist())

    def _on_theta(self, message: ControlInput) -> None:
        self._pass_on("theta", message, [message.theta])

    def _pass_on(self, name: str, message: Any, values: list[float]) -> None:
        channel, now = self._channels[name], time.monotonic() * self._scale
        channel.push(now, message, values)
        for passed, changed in channel.pop(now):
            self._send(name, passed, changed)

    def _send(self, name: str, message: Any, values: list[float]) -> None:
        if name == "state":
            message.x = array("d", values)
        elif values:
            message.theta = values[0]
        self._publishers_[name].publish(message)

    def _flush(self) -> None:
        now = time.monotonic() * self._scale
        for name, channel in self._channels.items():
            for message, values in channel.pop(now):
                self._send(name, message, values)


if __name__ == "__main__":
    sys.exit(run(FaultInjectorNode))
