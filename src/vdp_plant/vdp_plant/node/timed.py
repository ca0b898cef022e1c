"""The plant at the paces of a timer."""

from __future__ import annotations

import time
from array import array
from collections.abc import Mapping
from typing import Any

from koop_node.node.managed import OK, WARN, Entities
from koop_node.node.qos import NEWEST
from koop_node.node.schedule import Timer
from vdp_plant import pacing
from vdp_plant.config import PACING, PaceConfig
from vdp_plant.node.base import PlantRun
from vdp_plant.stage import TICK, PlantProgress, PlantStage


class TimedRun(PlantRun):
    """Paces realtime and scaled: a timer, the latest theta acts."""

    theta_qos = NEWEST
    theta_ages = True
    _late_before = _k_before = 0
    _timer: Timer | None = None
    _command = "waiting"

    def start(self, entities: Entities) -> None:
        self._due = time.monotonic() + self._period
        self._timer = entities.timer(self._period, self._tick)

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
        self._behind.add(now - self._due)
        late, self._due = pacing.tick(self._due, self._period, now)
        self.late += late
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

    # -- compiled -----------------------------------------------------------------------------

    def is_plain(self) -> bool:
        return self._timer is not None and self._command in ("ok", "off")

    def lend(self, rehearsal: bool) -> tuple[PlantStage, PlantProgress] | None:
        lent = super().lend(rehearsal)
        if lent is not None and self._timer is not None:
            self._timer.cancel()  # compiled code ticks until it is taken back
        return lent

    def take_back(self, before: PlantProgress, after: PlantProgress, now: float) -> None:
        super().take_back(before, after, now)
        if after.k != before.k:
            self._note_sent(self._k - 1, self._sent[(self._k - 1) % pacing.KEPT])
        if count := after.answered - before.answered:
            self._answered, self._round_trip = after.answered, after.round_trip
            self._input.follow_on(count, after.stamp, after.heard)
        if self._timer is not None:
            self._timer.restart(due=after.due)

    def handle(self, reason: int) -> None:
        super().handle(reason)
        if reason == TICK:
            self._tick()
