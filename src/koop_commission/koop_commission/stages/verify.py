"""``koop verify``: closes the loop with what was tuned, and compares it with the prediction."""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from koop_bringup.live.loop import LiveNodes
from koop_bringup.live.process import START_TIMEOUT
from koop_bringup.plan import plan
from koop_commission.rig.listener import Ears
from koop_commission.stages import time_scale
from koop_commission.stages.excite import BAR, mend, refuse_small_disk
from koop_commission.stages.session import Session, Watch, refuse_incomplete_state, session
from koop_commission.theta.commander_client import note_of
from koop_core.config.fields import parse_field
from koop_core.config.parameter import ConfigError
from koop_core.errors import LiveError
from koop_core.text_table import table
from koop_tune.excitation import progress as progress_file
from koop_tune.folder import CONTROLLER, FIGURES, TUNED
from koop_tune.rig import rig_file
from koop_tune.rig.rig_file import THETA, THETA_TYPE, RigFile
from koop_tune.search.agreement import (
    Aim,
    Measured,
    agreement,
    as_predicted,
    disagreements,
    may_yet_agree,
    measure,
    read_aim,
    verdict,
)

NAME = "verify.json"
THETA_ASKED = "/koop_verify/theta"  # what the controller says; the commander gives it to the rig
BEFORE = 8  # windows before the loop is closed, and after it at the theta that it found
LONGER = 2.0  # times as long, that a loop is closed which may agree yet
ESC = "relay_esc"


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser(
        "verify",
        description="Closes the loop with what 'koop tune' chose, from both ends of theta's range, "
        "records it, and compares it with the prediction. Limits, rate and the way back to "
        "theta_safe are kept by the commander, as 'koop excite' does. The same command goes on "
        "where it was interrupted. Exit code 0 only if the rig was damped as predicted.",
    )
    parser.add_argument("rig", metavar="RIG.YAML", help="of 'koop commission --new'")
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="of 'koop excite' and tune")
    time_scale.add_to(parser)
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 0 only if the rig was damped as predicted."""
    from koop_commission.report import reported  # slow to import

    rig = rig_file.read(args.rig)
    watch = Watch(time_scale.of(args), note_of(args.rig))
    again = f"./koop verify {args.rig} {args.folder}{time_scale.words(args)}"
    try:
        found = verify(rig, args.folder, watch)
    except LiveError as error:
        raise LiveError(f"{error}; to go on: {again}") from None
    except KeyboardInterrupt:
        print(f"\ninterrupted: theta is back at {rig.theta_safe:g}; to go on: {again}")
        return 130
    print("\n" + shown(found) + "\n\n" + found["verdict"])
    print(reported(args.folder))
    return 0 if as_predicted(found["rounds"][-1]) else 1


def verify(rig: RigFile, folder: Path, watch: Watch) -> dict[str, Any]:
    """Close the loop from each start, and return what is in verify.json.

    Parameters
    ----------
    rig : RigFile
        The rig, which runs.
    folder : Path
        Of the excitation; ``tuned`` is below it. A round that was begun there goes on.
    watch : Watch
        How the rig is watched.

    Raises
    ------
    koop_core.errors.LiveError
        If it ends before that; theta is at its safe value then.
    koop_core.config.parameter.ConfigError
        If the folder holds no controller for this rig.
    """
    refuse_incomplete_state(rig)
    aim = read_aim(folder / TUNED / FIGURES, rig)
    found = load(folder)
    rounds = found["rounds"]
    if (
        not rounds
        or rounds[-1]["agrees"] is not None
        or rounds[-1]["prediction"] != aim.predicted.as_json()
    ):
        rounds.append({"round": len(rounds) + 1, "runs": [], "prediction": aim.predicted.as_json(),
                       "agrees": None, "says": ""})  # fmt: skip
    now = rounds[-1]
    starts = [theta for theta in (rig.theta_min, rig.theta_max)]
    left = [theta for theta in starts if theta not in [run["start"] for run in now["runs"]]]
    settle = settling(rig, folder, aim)
    besides = settle + 2 * BEFORE * aim.window + 1.5 * rig.span / rig.theta_rate
    refuse_small_disk(rig, folder, len(left) * (besides + aim.longest))
    least, most = (
        len(left) * (besides + closed) / watch.scale / 60.0
        for closed in (aim.duration, aim.longest)
    )
    print(
        f"closing the loop from theta = {' and '.join(f'{start:.4g}' for start in left)}: "
        f"{aim.duration:.4g} s each, up to {aim.longest:.4g} s where theta takes longer to come to "
        f"rest; with the ways there and back about {least:.1f} min, at most {most:.1f} min; "
        f"Ctrl-C ends it, theta ends at {rig.theta_safe:g}",
        flush=True,
    )
    for start in left:
        run = closed_from(start, rig, folder, now["round"], aim, watch, settle)
        now["runs"].append(run)
        save(found, folder)
    worse = [text for run in now["runs"] for text in disagreements(aim, _measured(run))]
    now["agrees"], now["says"] = not worse, "; ".join(worse) or agreement(now)
    save(found, folder)
    return judge(rig, folder, len(rounds) - 1)


def judge(rig: RigFile, folder: Path, which: int) -> dict[str, Any]:
    """Write the verdict on the controller of ``tuned`` into verify.json, and return what is there.

    Parameters
    ----------
    rig : RigFile
        The rig.
    folder : Path
        Of the excitation.
    which : int
        The round in which that controller was verified; the first is 0.
    """
    found, aim = load(folder), read_aim(folder / TUNED / FIGURES, rig)
    measured = [_measured(run) for run in found["rounds"][which]["runs"]]
    found["damped"] = all(run.damped for run in measured)
    found["feature"] = aim.name
    found["verdict"] = verdict(aim, measured, len(found["rounds"]), str(folder))
    save(found, folder)
    return found


def settling(rig: RigFile, folder: Path, aim: Aim) -> float:
    """Return how long the rig needs to settle [s]: as its excitation saw it, else its own time."""
    known = progress_file.load(rig, folder)
    return max([aim.time, *(visit.settled for visit in known.visits)] if known else [aim.time])


def closed_from(
    start: float, rig: RigFile, folder: Path, number: int, aim: Aim, watch: Watch, settle: float
) -> dict[str, Any]:
    """Drive theta to a start, close the loop, and return what came of it."""
    count = 1
    while (own := folder / f"verify-{number}" / f"start-{count}").exists():
        mend(own / "bag")  # of one that was interrupted
        count += 1
    nodes = LiveNodes(
        own, nodes_of(rig, folder, own, start, aim), rig=True,
        remaps=[f"{ESC}:theta:={THETA_ASKED}"],
    )  # fmt: skip
    with session("koop_verify", rig, watch, nodes, follows=THETA_ASKED) as there:
        run = Run(rig, aim, watch, there).run(start, settle)
    return {"start": start, "bag": str((own / "bag").relative_to(folder)), **run}


def nodes_of(
    rig: RigFile, folder: Path, own: Path, start: float, aim: Aim
) -> dict[str, dict[str, Any]]:
    """Return the nodes that run beside: those of ``koop up``, whose controller waits."""
    file = folder / TUNED / CONTROLLER
    given = {"params": str(file), "plant": "false", "record": "true", "output": str(own)}
    values = plan(given).parameters
    low = float(aim.scale.u(np.array(start))) <= float(aim.scale.u(np.array(aim.theta)))
    esc = values[ESC]
    esc |= {
        "autostart": False,
        "theta_initial": start,
        "epsilon_initial": -1 if low else 1,
        "command_topic": "",
        "recorders": 1,
    }
    return values


class Run:
    """One closed loop.

    Parameters
    ----------
    rig, aim, watch, own
        The rig, what the loop should come to, how it is watched, and the session with it.
    """

    def __init__(self, rig: RigFile, aim: Aim, watch: Watch, own: Session) -> None:
        self._rig, self._aim, self._own, self._scale = rig, aim, own, watch.scale
        self._ears = own.ears
        fields = (parse_field("theta"), parse_field("epsilon"))
        self._theta = Ears(own.client, THETA, THETA_TYPE, fields, reliable=True)
        self._bar = tqdm(bar_format=BAR, leave=False, disable=None, total=1.0)
        self._what, self._begin, self._total = "", 0, 1.0
        own.shown = self._show
        own.still = aim.how.length

    def run(self, start: float, settle: float) -> dict[str, Any]:
        """Drive theta to a start, close the loop, hold theta where it ended, and measure."""
        own, aim, rig = self._own, self._aim, self._rig
        rest = BEFORE * aim.how.length
        own.client.change_state(f"/{ESC}", "configure", START_TIMEOUT, own.check)
        self._go(start)
        self._wait(math.ceil(settle / rig.dt), "settling")
        begin = self._ears.count
        self._wait(rest, "before")
        before = self._ears.samples(begin, begin + rest).x
        own.hand.follow()
        own.client.change_state(f"/{ESC}", "activate", START_TIMEOUT, own.check)
        own.until(self._answered)
        closed, first = self._ears.count, self._theta.count
        seconds = aim.duration
        while True:
            left = math.ceil(seconds / rig.dt) - (self._ears.count - closed)
            self._wait(left, "closed loop")
            end, last = self._ears.count, self._theta.count
            x, theta = self._ears.samples(closed, end), self._theta.samples(first, last).x[:, 0]
            found = measure(aim, before, x.x, theta)
            if seconds >= aim.longest or not may_yet_agree(aim, found):
                break
            seconds = min(LONGER * seconds, aim.longest)
        # theta rests where the loop ended: what is learned from a recording is learned from rests
        self._go(found.theta)
        self._wait(rest, "rest")
        own.client.change_state(f"/{ESC}", "deactivate", START_TIMEOUT, own.check)
        self._bar.close()
        return {
            **asdict(found),
            "closed": {"seconds": seconds, "steps": [int(x.step[0]), int(x.step[-1])]},
        }

    def _answered(self) -> bool:
        """Return whether theta is the controller's: only that one's answers have a relay."""
        count = self._theta.count
        return bool(count and self._theta.samples(count - 1).x[0, 1] != 0.0)

    def _go(self, theta: float) -> None:
        self._what = f"to {theta:.4g}"
        self._own.go(theta)

    def _wait(self, count: int, what: str) -> None:
        """Wait for some states."""
        self._what, self._begin = what, self._ears.count
        self._total = self._bar.total = count * self._rig.dt
        self._own.until(lambda: self._ears.count >= self._begin + count)

    def _show(self) -> None:
        self._bar.set_description_str(f"{self._what:<12}", refresh=False)
        self._bar.n = min((self._ears.count - self._begin) * self._rig.dt, self._total)
        self._bar.set_postfix_str(f", theta {self._own.hand.theta:+.4g}", refresh=True)


def shown(found: dict[str, Any]) -> str:
    """Return the runs of the last round beside the prediction."""
    now = found["rounds"][-1]
    p, runs = now["prediction"], [_measured(run) for run in now["runs"]]

    def row(name: str, unit: float, values: list[float | None], band: dict[str, Any]) -> list[str]:
        cells = ["never" if v is None else f"{unit * v:.3g}" for v in values]
        low, middle, high = (
            "never" if band[key] is None else f"{unit * band[key]:.3g}"
            for key in ("low", "middle", "high")
        )
        return [name, *cells, f"{middle} ({low} to {high})"]

    rows = [
        row("converges in [s]", 1.0, [run.time_to_converge for run in runs], p["converges"]),
        row("|theta - theta*| [% of range]", 100.0, [r.distance for r in runs], p["distance"]),
        row("amplitude over the best", 1.0, [run.excess for run in runs], p["excess"]),
        row("reduction, a factor of", 1.0, [run.reduction for run in runs], p["reduction"]),
        ["theta at the end", *(f"{run.theta:.4g}" for run in runs), ""],
        ["swing of theta", *(f"{run.swing:.3g}" for run in runs), ""],
    ]
    starts = [f"from {run['start']:.4g}" for run in now["runs"]]
    return table([f"round {now['round']}", *starts, "predicted"], rows)


def load(folder: Path) -> dict[str, Any]:
    """Return what is in verify.json; an empty one if there is none.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If it cannot be used.
    """
    path = folder / NAME
    if not path.exists():
        return {"rounds": [], "damped": False, "verdict": ""}
    try:
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        for item in found["rounds"]:
            _ = item["agrees"], item["prediction"], [_measured(run) for run in item["runs"]]
        return found
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{path}: cannot be read ({error}): move it away") from None


def save(found: dict[str, Any], folder: Path) -> None:
    """Write verify.json; it is whole at any time.

    Raises
    ------
    koop_core.errors.LiveError
        If the disk is full.
    """
    progress_file.write_whole(folder / NAME, found)


def _measured(run: dict[str, Any]) -> Measured:
    return Measured(**{name: run[name] for name in Measured.__dataclass_fields__})
