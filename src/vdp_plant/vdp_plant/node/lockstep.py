"""The plant in lockstep."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from koop_core.stream.resend import Due, Resend
from koop_node.node.managed import ERROR, OK, Entities, ManagedNode
from vdp_plant.config import PACING, PaceConfig
from vdp_plant.node.base import PlantRun
from vdp_plant.stage import WINDOW, PlantProgress

CHECK_PERIOD = 0.05  # [s] between looks whether an answer is overdue
SILENT = "the lifter (koopman_lifter) or the controller (relay_esc) is silent"


class LockstepRun(PlantRun):
    """Pace lockstep: every step waits for its theta, and asks for it again."""

    def __init__(self, node: ManagedNode[PlantRun]) -> None:
        super().__init__(node)
        self._state_message.lockstep = True
        self._question = Resend(node.parameters[PaceConfig].theta_timeout, PACING.resends)
        self._held_since: float | None = None
        self._holds = True
        """Whether the plant waits for listeners that fall behind."""

    def start(self, entities: Entities) -> None:
        entities.timer(CHECK_PERIOD, self._check_answer)
        if self._question.open:  # activated again: ask for the theta that is still missing
            self._send_again()
            self._question.ask(time.monotonic())
        else:
            self._ask()

    def deactivate(self) -> None:
        super().deactivate()
        self._held_since = None

    def parameters_changed(self, names: set[str]) -> None:
        super().parameters_changed(names)
        self._question.timeout = self._node.parameters[PaceConfig].theta_timeout

    def condition(self) -> tuple[int, str, Mapping[str, object]]:
        if self._question.overdue:
            return ERROR, SILENT, {"command": "overdue"}
        return OK, "running", {"command": "ok"}

    def _ask(self) -> None:
        if self._holds and self._k % WINDOW == 0 and not self._all_keep_up(CHECK_PERIOD):
            self._held_since = time.monotonic()
            return
        self._publish()
        self._question.ask(time.monotonic())

    def _all_keep_up(self, patience: float) -> bool:
        """Return whether nobody falls behind, or catches up within a time [s].

        Nothing else paces pure listeners: what a recorder that was not scheduled for a
        while can't catch up with is lost to it.
        """
        return self._outlets is None or self._outlets.acknowledged(patience)

    def _go_on(self, since: float) -> None:
        """Ask again once listeners that fell behind at a steady time [s] have caught up."""
        if not self._all_keep_up(0.0):
            if time.monotonic() - since < PACING.held:
                return
            self._holds = False
            self._node.get_logger().warning(
                "a subscriber of 'state' or 'ground_truth' has confirmed nothing for "
                f"{PACING.held:g} s: the plant goes on without waiting for it, and it may lose "
                "messages"
            )
        self._held_since = None
        self._ask()

    def _send_again(self) -> None:
        if self._outlets is not None:
            self._note_sent(self._k, time.monotonic())
            self._outlets.state.publish(self._state_message)

    def on_theta(self, message: Any, written: float) -> None:
        if message.step != self._k or not self._question.open or not self._usable(message):
            return
        self._theta = message.theta
        if self._question.close():
            self._node.get_logger().info(f"theta for step {self._k} was received late")
        self._advance(self._theta, message.step)
        if self._node.exit_code is None:
            self._ask()

    # -- compiled -----------------------------------------------------------------------------

    def is_plain(self) -> bool:
        return self._question.open and not self._question.overdue

    def take_back(self, before: PlantProgress, after: PlantProgress, now: float) -> None:
        super().take_back(before, after, now)
        if count := after.k - before.k:
            self._theta_step = self._k - 1
            self._note_sent(self._k, now)
            self._question.ask(now)
            self._input.follow_on(count, self._theta_step * self._params.dt, now)

    def _check_answer(self) -> None:
        if self._held_since is not None:
            self._go_on(self._held_since)
            return
        due = self._question.check(time.monotonic())
        if due is Due.WAIT or self._node.exit_code is not None:
            return
        what = f"no theta for step {self._k}"
        if due is Due.GIVE_UP:
            self._node.get_logger().error(f"{what}: {SILENT}")
            self._node.finish(1)
            return
        question = self._question
        self._node.get_logger().warning(
            f"{what} in {question.timeout:g} s: sending the state again "
            f"({question.resent} of {question.resends})"
        )
        self._send_again()
