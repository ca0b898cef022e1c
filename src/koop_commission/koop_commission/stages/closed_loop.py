"""One closed loop on a rig: theta driven to a start, the controller followed, the loop measured."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from koop_bringup.live.loop import LiveNodes
from koop_bringup.live.process import START_TIMEOUT
from koop_bringup.plan import plan
from koop_commission.rig.listener import Listener
from koop_commission.stages.session import Session, open_session
from koop_core.config.fields import parse_field
from koop_tune.excitation import progress
from koop_tune.folder import CONTROLLER, TUNED
from koop_tune.rig.rig_file import THETA, THETA_TYPE, RigFile
from koop_tune.search.agreement import Aim, may_yet_agree, measure
from koop_tune.search.rounds import LoopRun

THETA_ASKED = "/koop_verify/theta"  # what the controller asks for; the commander passes it on
BEFORE = 8  # windows before the loop is closed, and after it at the theta that it reached
LONGER = 2.0  # factor by which a loop that may agree yet is closed for longer
ESC = "relay_esc"


@dataclass(frozen=True)
class ClosedLoop:
    """The loops of one round on a rig.

    Attributes
    ----------
    rig : RigFile
        The rig.
    aim : Aim
        Prediction of the tuning.
    folder : Path
        Folder of the excitation.
    number : int
        The round; the first is 1.
    note : Path or None
        File that notes where theta was left.
    """

    rig: RigFile
    aim: Aim
    folder: Path
    number: int
    note: Path | None

    @property
    def settling(self) -> float:
        """Time that the rig needs to settle [s]: as its excitation showed, else its own time."""
        state = progress.load(self.rig, self.folder)
        return max([self.aim.time, *(visit.settled for visit in (state.visits if state else ()))])

    def record(self, start: float) -> LoopRun:
        """Drive theta to a start, close the loop, and return its figures."""
        count = 1
        while (run := self.folder / f"verify-{self.number}" / f"start-{count}").exists():
            count += 1
        remaps = [f"{ESC}:theta:={THETA_ASKED}"]
        nodes = LiveNodes(run, self._plan_nodes(run, start), rig=True, remaps=remaps)
        with open_session("koop_verify", self.rig, nodes, self.note, THETA_ASKED) as session:
            return self._drive(session, start, str((run / "bag").relative_to(self.folder)))

    def _plan_nodes(self, run: Path, start: float) -> dict[str, dict[str, Any]]:
        """Return the parameters of the nodes of ``koop up``; the controller waits."""
        file = self.folder / TUNED / CONTROLLER
        arguments = {"params": str(file), "plant": "false", "record": "true", "output": str(run)}
        parameters = plan(arguments).parameters
        u = self.aim.scale.u(np.array([start, self.aim.theta]))
        parameters["koopman_lifter"]["listeners"] = "recorder"  # it works before the controller
        parameters[ESC] |= {
            "autostart": False,
            "theta_initial": start,
            "epsilon_initial": -1 if u[0] <= u[1] else 1,
            "command": "",
            "listeners": "next recorder",
        }
        return parameters

    def _drive(self, session: Session, start: float, bag: str) -> LoopRun:
        """Close the loop at a start, and hold theta where it ended."""
        aim, dt, states = self.aim, self.rig.dt, session.listener
        fields = (parse_field("theta"), parse_field("epsilon"))
        answers = Listener(session.client, THETA, THETA_TYPE, fields, reliable=True)
        rest = BEFORE * aim.bands.length
        session.still = aim.bands.length
        session.client.change_state(f"/{ESC}", "configure", START_TIMEOUT, session.check)
        session.go(start)
        session.wait_for_states(math.ceil(self.settling / dt), "settling")
        begin = states.count
        session.wait_for_states(rest, "before")
        before = states.samples(begin, begin + rest).x
        session.commander.follow()
        session.client.change_state(f"/{ESC}", "activate", START_TIMEOUT, session.check)
        session.wait_until(lambda: _has_direction(answers))
        closed, first = states.count, answers.count
        seconds = aim.duration
        while True:
            left = math.ceil(seconds / dt) - (states.count - closed)
            session.wait_for_states(left, "closed loop")
            loop = states.samples(closed)
            theta = answers.samples(first).x[:, 0]
            measured = measure(aim, before, loop.x, theta)
            if seconds >= aim.longest or not may_yet_agree(aim, measured):
                break
            seconds = min(LONGER * seconds, aim.longest)
        # theta is held where the loop ended: a later tuning learns from dwell points
        session.go(measured.theta)
        session.wait_for_states(rest, "after")
        session.client.change_state(f"/{ESC}", "deactivate", START_TIMEOUT, session.check)
        return LoopRun(start, measured, bag, seconds, (int(loop.step[0]), int(loop.step[-1])))


def _has_direction(answers: Listener) -> bool:
    """Return whether the newest theta is the controller's: only a relay has a direction."""
    count = answers.count
    return bool(count and answers.samples(count - 1).x[0, 1] != 0.0)
