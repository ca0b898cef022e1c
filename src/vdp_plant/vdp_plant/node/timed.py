"""The plant at the paces realtime and scaled."""

from __future__ import annotations

import time
from array import array
from collections.abc import Mapping
from typing import Any

from koop_core.stream.durations import Durations
from koop_node.node.managed import OK, WARN, Entities, ManagedNode
from koop_node.node.qos import NEWEST
from koop_node.node.schedule import Timer
from vdp_plant.config import PACING, PaceConfig
from vdp_plant.node.base import PlantRun
from vdp_plant.pacing import Ticks


class TimedRun(PlantRun):
    """Paces realtime and scaled: a timer, the latest theta acts."""

    theta_qos = NEWEST
    theta_ages = True

    def __init__(self, node: ManagedNode[PlantRun]) -> None:
        super().__init__(node)
        self._period = node.parameters[PaceConfig].period(self._params.dt)
        self._ticks = Ticks(self._period)
        self.late = self._late_before = self._k_before = 0
        self._timer: Timer | None = None
        self._behind, self._round_trips = Durations(), Durations()
        self._command = "waiting"
        self._answered = -1  # step of the latest theta

    def start(self, entities: Entities) -> None:
        self._ticks.start(time.monotonic())
        self._timer = entities.timer(self._period, self._tick)

    def describe_steps(self) -> str:
        return f"{self.late} late ticks"

    def condition(self) -> tuple[int, str, Mapping[str, object]]:
        late, self._late_before = self.late - self._late_before, self.late
        ticks, self._k_before = self._k - self._k_before, self._k
        values = {
            "late_ticks": self.late,
            "ticks_behind": self._behind.text(),
            "round_trips": self._round_trips.text(),
            "command": self._command,
        }
        if self._command == "safe":
            safe = self._node.parameters[PaceConfig].theta_safe
            return WARN, f"theta_safe = {safe:g} acts", values
        if late > PACING.late * ticks:
            return WARN, f"{late} late ticks", values
        return OK, "running", values

    def _tick(self) -> None:
        now = time.monotonic()
        self.late += self._ticks.tick(now)
        self._behind.add(self._ticks.behind)
        self._publish()
        theta, pace = self._theta, self._node.parameters[PaceConfig]
        self._command = pace.watch(self._input.age(now))
        if self._command == "safe":
            theta = array("d", [pace.theta_safe] * len(theta))
        self._advance(theta, -1 if self._command == "safe" else self._answered)
        if self._node.exit_code is not None and self._timer is not None:
            self._timer.cancel()

    def on_theta(self, message: Any, written: float) -> None:
        if self._usable(message):
            self._theta, self._answered = message.theta, message.step
            self._round_trips.add(self._round_trip)
