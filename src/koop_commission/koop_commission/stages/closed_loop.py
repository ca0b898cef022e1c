"""One closed loop on a rig: theta driven to a start, the controller followed, the loop measured."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tqdm import tqdm

from koop_bringup.live.loop import LiveNodes
from koop_bringup.live.process import START_TIMEOUT
from koop_bringup.plan import Plan, plan
from koop_commission.fitness.samples import Samples
from koop_commission.rig.guarded_theta import GUARD, guard_remaps, guard_section
from koop_commission.rig.listener import Listener
from koop_commission.stages.session import Session, open_session, spell_time
from koop_core.config.fields import parse_field
from koop_tune.excitation.holds import mean_level
from koop_tune.folder import CONTROLLER, TUNED
from koop_tune.rig.rig_file import THETA, THETA_TYPE, RigFile
from koop_tune.search.agreement import (
    Aim,
    find_disagreements,
    find_faults,
    measure,
    spell,
    with_hold,
)
from koop_tune.search.rounds import LoopRun

LINES, QUIET = 8, 5.0  # lines about a closed loop at most, and time between two at least [s]
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
    settling : float
        Time that the rig needs to settle [s].
    note : Path or None
        File that notes where theta was left.
    """

    rig: RigFile
    aim: Aim
    folder: Path
    number: int
    settling: float
    note: Path | None

    def record(self, start: tuple[float, ...]) -> LoopRun:
        """Drive theta to a start, close the loop, and return its figures."""
        count = 1
        while (run := self.folder / f"verify-{self.number}" / f"start-{count}").exists():
            count += 1
        remaps = guard_remaps(self.rig)
        nodes = LiveNodes(run, Plan(self._plan_nodes(run, start), rig=True, remaps=remaps))
        with open_session(self.rig, nodes, self.note) as session:
            return self._drive(session, start, str((run / "bag").relative_to(self.folder)))

    def _plan_nodes(self, run: Path, start: tuple[float, ...]) -> dict[str, dict[str, Any]]:
        """Return the parameters of the nodes of ``koop up``; the controller waits."""
        file = self.folder / TUNED / CONTROLLER
        arguments = {"params": str(file), "plant": "false", "record": "true", "output": str(run)}
        parameters = plan(arguments).parameters
        parameters[GUARD] = guard_section(self.rig, self.note)  # the limits of the rig
        parameters["koopman_lifter"]["listeners"] = "recorder"  # it works before the controller
        parameters[ESC] |= {
            "autostart": False,
            "theta_initial": list(start) if len(start) > 1 else start[0],
            "listeners": f"{GUARD} recorder",
        }
        return parameters

    def _drive(self, session: Session, start: tuple[float, ...], bag: str) -> LoopRun:
        """Close the loop at a start, and hold theta where it ended."""
        aim, dt, states = self.aim, self.rig.dt, session.listener
        fields = [*(f"theta[{k}]" for k in range(len(start))), "epsilon"]
        paths = tuple(map(parse_field, fields))
        answers = Listener(session.client, THETA, THETA_TYPE, paths, reliable=True)
        margins = None if self.rig.bounded is None else session.listen_to_margins()
        rest = aim.settings.before * aim.amplitude.windows.length
        session.still = aim.amplitude.windows.length
        session.client.change_state(f"/{ESC}", "configure", START_TIMEOUT, session.check)
        quiet = self.settling + rest * dt
        tqdm.write(
            f"theta = {spell(start)}, the loop open: {spell_time(quiet, self.rig.pace)} until the "
            "rig has settled there and its amplitude is known",
        )
        session.go(start)
        session.wait_for_states(math.ceil(self.settling / dt), "settling")
        begin = states.count
        session.wait_for_states(rest, "before")
        before = states.samples(begin, begin + rest).x
        session.theta.follow()
        session.client.change_state(f"/{ESC}", "activate", START_TIMEOUT, session.check)
        session.wait_until(lambda: _has_direction(answers))
        closed, first = states.count, answers.count
        seconds, how = aim.duration, "the loop is closed"
        while True:
            tqdm.write(f"{how}: {spell_time(seconds, self.rig.pace)} in all")
            self._wait(session, closed, seconds)
            loop = states.samples(closed)
            theta = answers.samples(first).x[:, :-1]
            measured = measure(aim, before, loop.x, theta)
            if margins is not None:
                measured = replace(measured, broken=find_broken(margins.samples(), loop))
            lacks = find_faults(aim, [measured]) or find_disagreements(aim, measured)
            if seconds >= aim.longest or not lacks:
                break
            # an adaptive law arrives with a large step and takes its time to make it small
            seconds = min(aim.settings.longer * seconds, aim.longest)
            how = f"not yet, {lacks[0]}: the loop stays closed"
        tqdm.write(
            f"theta is held at {spell(measured.theta)}, its mean in the second half of the loop: "
            f"{spell_time(aim.time + rest * dt, self.rig.pace)} until it is known what is left",
        )
        session.go(measured.theta)
        session.wait_for_states(math.ceil(aim.time / dt), "settling")
        begin = states.count
        session.wait_for_states(rest, "after")
        measured = with_hold(aim, measured, states.samples(begin, begin + rest).x)
        session.client.change_state(f"/{ESC}", "deactivate", START_TIMEOUT, session.check)
        return LoopRun(start, measured, bag, seconds, (int(loop.step[0]), int(loop.step[-1])))

    def _wait(self, session: Session, closed: int, seconds: float) -> None:
        """Wait until the loop was closed for a time [s]; say now and then how far it is."""
        states, dt, amplitude = session.listener, self.rig.dt, self.aim.amplitude
        every = math.ceil(max(seconds / LINES, QUIET * self.rig.pace) / dt)
        end = closed + math.ceil(seconds / dt)
        tail = self.aim.settings.before * amplitude.windows.length
        while (count := states.count) < end:
            due = min(count + every, end)
            session.show = lambda: session.draw("loop", (states.count - closed) * dt, seconds)
            session.wait_until(lambda: states.count >= due)  # noqa: B023 - called at once
            x = states.samples(max(closed, due - tail), due).x
            if x.shape[0] >= amplitude.windows.length:
                squares = amplitude.squares(amplitude.windows.powers(x))
                level = math.exp(mean_level(squares, amplitude.floor)[0])
                theta = spell(session.theta.value)
                at = (due - closed) * dt
                tqdm.write(f"{at:6.0f} s  theta {theta:<9} amplitude {level:.3g}")


def find_broken(margins: Samples, loop: Samples) -> float:
    """Return the share of a loop's second half in which its constraint was broken."""
    late = margins.x[margins.step >= loop.step[loop.step.size // 2], 0]
    return float((late < 0.0).mean()) if late.size else 0.0


def _has_direction(answers: Listener) -> bool:
    """Return whether the newest theta is the controller's: only a relay has a direction."""
    count = answers.count
    return bool(count and answers.samples(count - 1).x[0, -1] != 0.0)
