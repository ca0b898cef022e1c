"""``koop verify``: closes the loop with the tuned controller; compares it with the prediction."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from koop_bringup.live.loop import LiveNodes
from koop_bringup.live.process import START_TIMEOUT
from koop_bringup.plan import plan
from koop_commission.rig.listener import Listener
from koop_commission.stages.bags import recover_torn, refuse_small_disk
from koop_commission.stages.excite import BAR
from koop_commission.stages.session import Session, Watch, open_session, refuse_incomplete_state
from koop_commission.theta.commander_client import note_of
from koop_core.config.fields import parse_field
from koop_core.errors import LiveError
from koop_core.text_table import table
from koop_tune.excitation import progress as progress_file
from koop_tune.folder import CONTROLLER, FIGURES, TUNED
from koop_tune.rig import rig_file
from koop_tune.rig.rig_file import THETA, THETA_TYPE, RigFile
from koop_tune.search.agreement import (
    Aim,
    Measured,
    disagreements,
    may_yet_agree,
    measure,
    read_aim,
    verdict,
)
from koop_tune.search.prediction import Band
from koop_tune.search.rounds import (
    Round,
    Run,
    Verification,
    load_verification,
    save_verification,
)

THETA_ASKED = "/koop_verify/theta"  # what the controller asks for; the commander passes it on
BEFORE = 8  # windows before the loop is closed, and after it at the theta that it reached
LONGER = 2.0  # factor by which a loop that may agree yet is closed for longer
ESC = "relay_esc"


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser(
        "verify",
        description="Closes the loop with the controller of 'koop tune', from both ends of "
        "theta's range, records it, and compares it with the prediction. A commander keeps theta "
        "within its limits and rate and returns it to theta_safe, as in 'koop excite'. The same "
        "command resumes an interrupted one. Exit code 0 only if the rig is damped as predicted.",
    )
    parser.add_argument("rig", metavar="RIG.YAML", help="rig file, from 'koop commission --new'")
    parser.add_argument(
        "folder", type=Path, metavar="FOLDER", help="folder of 'koop excite' and 'koop tune'"
    )
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 0 only if the rig is damped as predicted."""
    from koop_commission.report import try_report  # slow to import

    rig = rig_file.read(args.rig)
    resume = f"to resume: ./koop verify {args.rig} {args.folder}"
    try:
        verification = verify(rig, args.folder, Watch(note_of(args.rig)))
    except LiveError as error:
        raise LiveError(f"{error}; {resume}") from None
    except KeyboardInterrupt:
        print(f"\ninterrupted: theta is back at {rig.theta_safe:g}; {resume}")
        return 130
    print("\n" + format_round(verification.rounds[-1]) + "\n\n" + verification.verdict)
    print(try_report(args.folder))
    return 0 if verification.rounds[-1].damped_as_predicted else 1


def verify(rig: RigFile, folder: Path, watch: Watch) -> Verification:
    """Close the loop from each start, and return the content of verify.json.

    Parameters
    ----------
    rig : RigFile
        The rig, which runs.
    folder : Path
        Folder of the excitation, which holds ``tuned``; a round that was begun there is resumed.
    watch : Watch
        How the rig is looked after.

    Raises
    ------
    koop_core.errors.LiveError
        If it ends early; theta is at theta_safe then.
    koop_core.config.parameter.ConfigError
        If the folder holds no controller for this rig.
    """
    refuse_incomplete_state(rig)
    aim = read_aim(folder / TUNED / FIGURES, rig)
    rounds = list(load_verification(folder).rounds)
    if not rounds or rounds[-1].finished or rounds[-1].prediction != aim.predicted:
        rounds.append(Round(len(rounds) + 1, aim.predicted))
    current = rounds.pop()
    done = [run.start for run in current.runs]
    left = [theta for theta in (rig.theta_min, rig.theta_max) if theta not in done]
    loop = ClosedLoop(rig, aim, watch, folder, current.number)
    besides = loop.settling + 2 * BEFORE * aim.window + 1.5 * rig.span / rig.theta_rate
    refuse_small_disk(rig, folder, len(left) * (besides + aim.longest))
    least, most = (
        len(left) * (besides + closed) / rig.pace / 60.0 for closed in (aim.duration, aim.longest)
    )
    print(
        f"closing the loop from theta = {' and '.join(f'{start:.4g}' for start in left)}: "
        f"{aim.duration:.4g} s each, up to {aim.longest:.4g} s where theta settles more slowly; "
        f"in all about {least:.1f} min, at most {most:.1f} min; "
        f"Ctrl-C ends it, theta returns to {rig.theta_safe:g}",
        flush=True,
    )
    for start in left:
        current = replace(current, runs=(*current.runs, loop.record(start)))
        save_verification(Verification((*rounds, current)), folder)
    worse = [text for run in current.runs for text in disagreements(aim, run.measured)]
    current = replace(current, agrees=not worse, summary="; ".join(worse) or current.agreement)
    save_verification(Verification((*rounds, current)), folder)
    return judge(rig, folder, len(rounds))


def judge(rig: RigFile, folder: Path, index: int) -> Verification:
    """Write the verdict on the controller of ``tuned`` into verify.json, and return its content.

    Parameters
    ----------
    rig : RigFile
        The rig.
    folder : Path
        Folder of the excitation.
    index : int
        Round in which that controller was verified; the first is 0.
    """
    verification, aim = load_verification(folder), read_aim(folder / TUNED / FIGURES, rig)
    runs = [run.measured for run in verification.rounds[index].runs]
    verification = replace(
        verification,
        damped=all(run.damped for run in runs),
        feature=aim.name,
        verdict=verdict(aim, runs, len(verification.rounds), str(folder)),
    )
    save_verification(verification, folder)
    return verification


@dataclass(frozen=True)
class ClosedLoop:
    """The loops of one round on a rig.

    Attributes
    ----------
    rig : RigFile
        The rig.
    aim : Aim
        Prediction of the tuning.
    watch : Watch
        How the rig is looked after.
    folder : Path
        Folder of the excitation.
    number : int
        The round; the first is 1.
    """

    rig: RigFile
    aim: Aim
    watch: Watch
    folder: Path
    number: int

    @property
    def settling(self) -> float:
        """Time that the rig needs to settle [s]: as its excitation showed, else its own time."""
        state = progress_file.load(self.rig, self.folder)
        return max([self.aim.time, *(visit.settled for visit in (state.visits if state else ()))])

    def record(self, start: float) -> Run:
        """Drive theta to a start, close the loop, and return its figures."""
        count = 1
        while (run := self.folder / f"verify-{self.number}" / f"start-{count}").exists():
            recover_torn(run / "bag")  # of one that was interrupted
            count += 1
        nodes = LiveNodes(
            run, self.plan_nodes(run, start), rig=True, remaps=[f"{ESC}:theta:={THETA_ASKED}"]
        )
        with open_session(
            "koop_verify", self.rig, self.watch, nodes, follows=THETA_ASKED
        ) as session:
            driver = LoopDriver(self.rig, self.aim, session)
            measured, seconds, steps = driver.run(start, self.settling)
        return Run(start, measured, str((run / "bag").relative_to(self.folder)), seconds, steps)

    def plan_nodes(self, run: Path, start: float) -> dict[str, dict[str, Any]]:
        """Return the parameters of the nodes of ``koop up``; the controller waits."""
        file = self.folder / TUNED / CONTROLLER
        arguments = {"params": str(file), "plant": "false", "record": "true", "output": str(run)}
        parameters = plan(arguments).parameters
        scale = self.aim.scale
        below = float(scale.u(np.array(start))) <= float(scale.u(np.array(self.aim.theta)))
        parameters[ESC] |= {
            "autostart": False,
            "theta_initial": start,
            "epsilon_initial": -1 if below else 1,
            "command_topic": "",
            "listeners": "next recorder",
        }
        return parameters


class LoopDriver:
    """Drives one closed loop.

    Parameters
    ----------
    rig, aim, session
        The rig, the prediction, and the session with the rig.
    """

    def __init__(self, rig: RigFile, aim: Aim, session: Session) -> None:
        self._rig, self._aim, self._session = rig, aim, session
        self._listener = session.listener
        fields = (parse_field("theta"), parse_field("epsilon"))
        self._theta = Listener(session.client, THETA, THETA_TYPE, fields, reliable=True)
        self._bar = tqdm(bar_format=BAR, leave=False, disable=None, total=1.0)
        self._phase, self._begin, self._total = "", 0, 1.0
        session.show = self._show
        session.still = aim.how.length

    def run(self, start: float, settle: float) -> tuple[Measured, float, tuple[int, int]]:
        """Drive theta to a start, close the loop, hold theta where it ended.

        Returns
        -------
        measured : Measured
            Figures of the loop.
        seconds : float
            Time for which it was closed [s].
        steps : tuple of int
            First and last step with the loop closed.
        """
        session, aim, rig = self._session, self._aim, self._rig
        rest = BEFORE * aim.how.length
        session.client.change_state(f"/{ESC}", "configure", START_TIMEOUT, session.check)
        self._go(start)
        self._wait(math.ceil(settle / rig.dt), "settling")
        begin = self._listener.count
        self._wait(rest, "before")
        before = self._listener.samples(begin, begin + rest).x
        session.commander.follow()
        session.client.change_state(f"/{ESC}", "activate", START_TIMEOUT, session.check)
        session.wait_until(self._is_controlled)
        closed, first = self._listener.count, self._theta.count
        seconds = aim.duration
        while True:
            left = math.ceil(seconds / rig.dt) - (self._listener.count - closed)
            self._wait(left, "closed loop")
            end, last = self._listener.count, self._theta.count
            states = self._listener.samples(closed, end)
            theta = self._theta.samples(first, last).x[:, 0]
            measured = measure(aim, before, states.x, theta)
            if seconds >= aim.longest or not may_yet_agree(aim, measured):
                break
            seconds = min(LONGER * seconds, aim.longest)
        # theta is held where the loop ended: a later tuning learns from dwell points
        self._go(measured.theta)
        self._wait(rest, "rest")
        session.client.change_state(f"/{ESC}", "deactivate", START_TIMEOUT, session.check)
        self._bar.close()
        return measured, seconds, (int(states.step[0]), int(states.step[-1]))

    def _is_controlled(self) -> bool:
        """Return whether theta is the controller's: only its answers have a relay's direction."""
        count = self._theta.count
        return bool(count and self._theta.samples(count - 1).x[0, 1] != 0.0)

    def _go(self, theta: float) -> None:
        self._phase = f"to {theta:.4g}"
        self._session.go(theta)

    def _wait(self, count: int, phase: str) -> None:
        """Wait for some states."""
        self._phase, self._begin = phase, self._listener.count
        self._total = self._bar.total = count * self._rig.dt
        self._session.wait_for_states(count)

    def _show(self) -> None:
        theta = self._session.commander.theta
        self._bar.set_description_str(f"{self._phase:<12}", refresh=False)
        self._bar.n = min((self._listener.count - self._begin) * self._rig.dt, self._total)
        self._bar.set_postfix_str(f", theta {theta:+.4g}", refresh=True)


def format_round(item: Round) -> str:
    """Return the runs of a round beside the prediction, as a table."""
    p, runs = item.prediction, [run.measured for run in item.runs]

    def row(name: str, values: list[float | None], band: Band, unit: float = 1.0) -> list[str]:
        cells = ["never" if value is None else f"{unit * value:.3g}" for value in values]
        return [name, *cells, band.as_text(unit)]

    rows = [
        row("converges in [s]", [run.time_to_converge for run in runs], p.converges),
        row("|theta - theta*| [% of range]", [run.distance for run in runs], p.distance, 100.0),
        row("amplitude over the best", [run.excess for run in runs], p.excess),
        row("reduction, a factor of", [run.reduction for run in runs], p.reduction),
        ["theta at the end", *(f"{run.theta:.4g}" for run in runs), ""],
        ["swing of theta", *(f"{run.swing:.3g}" for run in runs), ""],
    ]
    starts = [f"from {run.start:.4g}" for run in item.runs]
    return table([f"round {item.number}", *starts, "predicted"], rows)
