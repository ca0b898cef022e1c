"""The plant in lockstep."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from koop_msgs.msg import ControlInput

from koop_core.port import NO_PORT
from koop_core.stream.resend import Due, Resend
from koop_node.node.managed import ERROR, OK, Entities, ManagedNode
from koop_node.node.wire import codec
from vdp_plant.config import PACING, PaceConfig
from vdp_plant.node.base import PlantRun
from vdp_plant.stage import (
    GROUND_TRUTH,
    STATE,
    THETA,
    WINDOW,
    PlantProgress,
    PlantStage,
)

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
        self._compiled = 0  # steps without Python

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

    def describe_steps(self) -> str:
        return f"{self._compiled} of them compiled"

    def condition(self) -> tuple[int, str, Mapping[str, object]]:
        if self._question.overdue:
            return ERROR, SILENT, {"command": "overdue"}
        return OK, "running", {"command": "ok", "compiled_steps": self._compiled}

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
            self._sent.send(self._k, time.monotonic())
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

    def lend(self, rehearsal: bool) -> tuple[PlantStage, PlantProgress] | None:
        """Return what :func:`vdp_plant.stage.step_next` needs; None where it cannot go on."""
        reader, outlets, question = self.reader, self._outlets, self._question
        if len(self._theta) > 1 or (outlets is not None and outlets.clock is not None):
            return None
        plain = question.open and not question.overdue and self._node.exit_code is None
        taken = state = truth = NO_PORT
        if reader is not None and outlets is not None and plain and self._input.steady:
            theta = codec(ControlInput).new()
            theta.header, theta.theta = self._state_message.header, [0.0]
            taken = reader.port(theta, THETA)
            state = outlets.state.port(self._state_message, STATE)
            truth = outlets.ground_truth.port(self._ground_truth_message, GROUND_TRUTH)
        elif not rehearsal:
            return None
        stage = PlantStage(taken, state, truth, self._params, float(self._steps))
        return stage, PlantProgress(
            self._k, self._x, self._y, self._theta[0], self._theta_applied[0]
        )

    def take_back(self, before: PlantProgress, after: PlantProgress, now: float) -> None:
        """Go on where the compiled code ended."""
        outlets, count = self._outlets, after.k - before.k
        if not count or outlets is None:
            return
        self._compiled += count
        self._k, self._x, self._y, self._theta[0], self._theta_applied[0] = after
        self._theta_step = self._k - 1
        self._state_message = state = outlets.state.last()
        self._ground_truth_message = outlets.ground_truth.last()
        self._ground_truth_message.header = state.header
        self._sent.send(self._k, now)
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
