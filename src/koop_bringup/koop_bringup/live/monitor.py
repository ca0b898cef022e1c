"""Reports of the nodes of a running loop."""

from __future__ import annotations

import math
import time
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from koop_core.config.knobs import read_knobs
from koop_core.stream.report import LEVELS
from koop_loop.parameters import EXECUTABLES
from koop_node.client.client import Client


@dataclass
class Progress:
    """The last report about the loop on /diagnostics, and changed parameters.

    Attributes
    ----------
    step, steps_per_second, theta, r
        Last figures of the plant or, where a rig is the plant, of lifter and controller.
    values : dict
        All values by node.
    levels : dict
        By node, the level that it last reported.
    findings : dict
        By node, its level and message if it is not OK.
    heard : dict
        By node, steady time of its last report [s].
    changed : dict
        By node, parameters that were set while it ran, by name.
    """

    step: int = 0
    steps_per_second: float = math.nan
    theta: list[float] = field(default_factory=list)
    r: float = math.nan
    values: dict[str, dict[str, str]] = field(default_factory=dict)
    levels: dict[str, int] = field(default_factory=dict)
    findings: dict[str, str] = field(default_factory=dict)
    heard: dict[str, float] = field(default_factory=dict)
    changed: dict[str, dict[str, Any]] = field(default_factory=dict)

    @property
    def told(self) -> dict[str, str]:
        """Findings, the guard's first: what it does with the rig matters most."""
        return dict(sorted(self.findings.items(), key=lambda item: item[0] != "koop_guard"))


class Monitor(Client):
    """Listens to what is said rarely: watching must not cost the loop any speed.

    Parameters
    ----------
    namespace : str, optional
        Namespace of the loop, such as ``/rig``, or empty for the root; by default all are heard.
    """

    def __init__(self, namespace: str | None = None) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from rcl_interfaces.msg import ParameterEvent
        from rclpy.qos import qos_profile_parameter_events

        super().__init__("_koop_monitor")
        self.progress = Progress()
        self._namespace = namespace
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_message, 20)
        self.node.create_subscription(
            ParameterEvent, "/parameter_events", self._on_change, qos_profile_parameter_events
        )

    @property
    def theta(self) -> list[float]:
        """Last theta of the controller."""
        return read_knobs(self.progress.values.get("relay_esc", {}).get("theta", "nan"))

    def _on_change(self, event: Any) -> None:
        from koop_node.node.received import read_value

        namespace, _, node = event.node.rpartition("/")
        if self._namespace in (None, namespace):
            values = {p.name: read_value(p.value) for p in event.changed_parameters}
            self.progress.changed.setdefault(node, {}).update(values)

    def _on_message(self, message: Any) -> None:
        for status in message.status:
            namespace, _, node = status.name.split(":")[0].rpartition("/")
            if self._namespace in (None, namespace):
                with suppress(ValueError, IndexError):  # no node of ours reports such figures
                    self._take(node, status)

    def _take(self, node: str, status: Any) -> None:
        values = {item.key: item.value for item in status.values}
        progress, level = self.progress, status.level[0]
        finding = f"{node} {LEVELS[level]}: {status.message}"
        figures = values if node in EXECUTABLES else {}
        r, step = float(figures.get("r", progress.r)), int(figures.get("step", progress.step))
        rate = float(figures.get("rate_hz", math.nan))
        theta = read_knobs(figures["theta"]) if "theta" in figures else progress.theta
        progress.values[node] = values
        progress.levels[node] = level
        progress.heard[node] = time.monotonic()
        progress.findings.pop(node, None)
        if level:
            progress.findings[node] = finding
        if node == "koopman_lifter":
            progress.r = r
        plant = "vdp_plant" in progress.values
        if node == ("vdp_plant" if plant else "koopman_lifter"):
            progress.step, progress.steps_per_second = step, rate
        guard = "koop_guard" in progress.values  # what the rig gets, not what is asked for
        if node == ("vdp_plant" if plant else "koop_guard" if guard else "relay_esc"):
            progress.theta = theta
