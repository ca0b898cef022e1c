"""What the nodes of a running loop report."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from koop_node.client import Client


@dataclass
class Progress:
    """What /diagnostics last said about the loop."""

    step: int = 0
    steps_per_second: float = math.nan
    theta: float = math.nan
    r: float = math.nan
    values: dict[str, dict[str, str]] = field(default_factory=dict)


class Monitor(Client):
    """Listens to /diagnostics only: watching must not cost the loop any speed."""

    def __init__(self) -> None:
        from diagnostic_msgs.msg import DiagnosticArray

        super().__init__("koop_monitor")
        self.progress = Progress()
        self.levels: dict[str, int] = {}  # that every node last reported
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_message, 20)

    @property
    def theta(self) -> float:
        """Last theta of the controller."""
        return float(self.progress.values.get("relay_esc", {}).get("theta", math.nan))

    def _on_message(self, message: Any) -> None:
        for status in message.status:
            node = status.name.split(":")[0].strip("/").rsplit("/", 1)[-1]
            values = {item.key: item.value for item in status.values}
            self.progress.values[node] = values
            self.levels[node] = status.level[0]
            if node == "vdp_plant":
                self.progress.step = int(values.get("step", self.progress.step))
                self.progress.steps_per_second = float(values["rate_hz"])
                self.progress.theta = float(values.get("theta", self.progress.theta))
            elif node == "koopman_lifter":
                self.progress.r = float(values.get("r", self.progress.r))
