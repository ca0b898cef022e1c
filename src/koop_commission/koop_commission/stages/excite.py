"""``koop excite``: moves theta over its range and records, to make a controller from it."""

from __future__ import annotations

import argparse
import functools
import math
import time
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from koop_bag.recorder.run_folder import default_folder
from koop_bringup.live.loop import LiveNodes
from koop_commission.stages.bags import count_answers, recover_torn, refuse_small_disk
from koop_commission.stages.session import Session, Watch, open_session, refuse_incomplete_state
from koop_commission.theta.commander_client import note_of
from koop_commission.theta.limits import compute_return_time
from koop_core.config.parameter import ConfigError
from koop_core.errors import KoopError, LiveError
from koop_core.text_table import table
from koop_tune.excitation import progress as progress_file
from koop_tune.excitation.progress import Progress
from koop_tune.excitation.survey import SURVEY, Survey
from koop_tune.excitation.visits import unknown_twice
from koop_tune.rig import rig_file
from koop_tune.rig.rig_file import RigFile

GUESS = 12  # windows of a dwell point, before the first is known
BAR = "{desc} |{bar}| {n:.0f}/{total:.0f} s{postfix}"


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser(
        "excite",
        description="Moves theta over its range, up, down and in random order, with the lifter "
        "running, and records everything. theta is held at each dwell point until the rig has "
        "settled and the amplitude is known; the command ends when the static map is. Whatever "
        "ends it, theta returns to theta_safe at the permitted rate. The same command with the "
        "same --out resumes an interrupted one.",
    )
    parser.add_argument("rig", metavar="RIG.YAML", help="rig file, from 'koop commission --new'")
    parser.add_argument(
        "--out", type=Path, metavar="DIR",
        help="folder of the recordings (default: recordings/TIME-NAME)",
    )  # fmt: skip
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 0 if theta was at every dwell point at least twice."""
    from koop_commission.report import try_report  # slow to import

    rig = rig_file.read(args.rig)
    folder = args.out or default_folder(Path(args.rig).stem)
    resume = f"to resume: ./koop excite {args.rig} --out {folder}"
    try:
        progress = excite(rig, folder, Watch(note_of(args.rig)))
    except LiveError as error:
        raise LiveError(f"{error}; {resume}") from None
    except KeyboardInterrupt:
        print(f"\ninterrupted: theta is back at {rig.theta_safe:g}; {resume}")
        return 130
    print("\n" + describe_result(rig, folder, progress))
    print(try_report(folder))
    print(f"next: ./koop tune {args.rig} {folder}")
    return 1 if unknown_twice(progress.visits, len(progress.values)) else 0


def describe_result(rig: RigFile, folder: Path, progress: Progress) -> str:
    """Return the result of an excitation in words."""
    bags = [folder / part / "bag" for part in progress.parts]
    states, answered = np.sum([count_answers(bag) for bag in bags], axis=0)
    reason = (
        "the static map is known well enough" if progress.done
        else f"the {rig.time:g} s of the rig file are over"
    )  # fmt: skip
    return (
        f"{format_map(rig, progress)}\n\n{reason}; theta is back at {rig.theta_safe:g}\n"
        f"recorded {states} states, {answered} of them with a theta"
    )


def excite(rig: RigFile, folder: Path, watch: Watch, seed: int = 0) -> Progress:
    """Move theta over its range and record, until the static map is known or the time is over.

    Parameters
    ----------
    rig : RigFile
        The rig, which runs.
    folder : Path
        Folder of the recordings; an excitation that was begun there is resumed.
    watch : Watch
        How the rig is looked after.
    seed : int
        Seed of the random order.

    Raises
    ------
    koop_core.errors.LiveError
        If it ends early: the rig, a node or the disk fails, a limit is crossed, another publisher
        commands theta. theta is at theta_safe then.
    koop_core.config.parameter.ConfigError
        If the folder holds the recordings of another rig, or a finished excitation.
    """
    refuse_incomplete_state(rig)
    state = progress_file.load(rig, folder) or progress_file.begin(seed, rig)
    if state.done:
        raise ConfigError(f"{folder}: the static map is known already: choose another --out")
    refuse_small_disk(rig, folder, rig.time - state.elapsed)
    for name in state.parts:
        recover_torn(folder / name / "bag")
    number = len(state.parts) + 1
    while (folder / (part := f"part-{number}")).exists():  # of one killed before it was noted
        number += 1

    def note_part() -> None:
        state.parts.append(part)
        progress_file.save(state, rig, folder)

    lifter: dict[str, Any] = {
        "cost": "raw",
        "dt": rig.dt,
        "listeners": "recorder",
        **rig.lifter_input,
    }
    parameters: dict[str, dict[str, Any]] = {
        "recorder": {"output": str(folder / part)},
        "koopman_lifter": lifter,
    }
    nodes = LiveNodes(folder / part, parameters, rig=True)
    with open_session("koop_excite", rig, watch, nodes, note_part) as session:
        Excitation(rig, folder, state, session).run()
    return state


class Excitation:
    """One part of an excitation, from its first state to its end.

    Parameters
    ----------
    rig : RigFile
        The rig.
    folder : Path
        Folder of all parts.
    state : Progress
        Done so far; it grows.
    session : Session
        With the rig.
    """

    def __init__(self, rig: RigFile, folder: Path, state: Progress, session: Session) -> None:
        self._rig = rig
        self._folder = folder
        self._state = state
        self._session = session
        self._listener = session.listener
        self._survey = Survey(rig, state)
        self._begin, self._before, self._began = 0, state.elapsed, time.monotonic()
        self._bar = tqdm(bar_format=BAR, leave=False, disable=None, total=1.0)
        session.show = self._show

    @property
    def _elapsed(self) -> float:
        """Time of all parts [s], of the rig's own time."""
        if getattr(self._listener.last, "lockstep", False):
            return self._before + (self._listener.count - self._begin) * self._rig.dt
        return self._before + (time.monotonic() - self._began) * self._rig.pace

    @property
    def _time_left(self) -> float:
        """Time of the rig file that is left [s]."""
        return max(self._rig.time - self._elapsed, 0.0)

    # -- moving -------------------------------------------------------------------------------

    def run(self) -> None:
        """Move theta until the map is known or the time is over."""
        state = self._state
        self._begin, self._began = self._listener.count, time.monotonic()
        if state.how is None:
            self._listen()
        assert state.how is not None
        self._session.still = state.how.length
        self._print_forecast()
        while (value := self._survey.next_value()) is not None and self._dwell(value):
            self._save()
        self._save()
        self._bar.close()

    def _save(self) -> None:
        self._state.elapsed = self._elapsed
        progress_file.save(self._state, self._rig, self._folder)

    def _listen(self) -> None:
        """Choose the windows from the oscillation before theta moves."""
        dt = self._rig.dt
        while self._survey.listens(x := self._listener.samples(self._begin).x):
            self._session.wait_for_states(math.ceil(0.2 * SURVEY.shortest / dt))
        try:
            periods = self._survey.look(x)
        except KoopError as error:
            raise LiveError(str(error)) from None
        assert self._state.how is not None
        print(
            f"periods from {min(periods):.3g} to {periods.slowest:.3g} s: amplitudes are taken in "
            f"windows of {self._state.how.length * dt:.3g} s",
            flush=True,
        )

    def _dwell(self, value: float) -> bool:
        """Hold theta at a dwell point as long as it needs; return False if the time is over."""
        rig, how, survey = self._rig, self._state.how, self._survey
        assert how is not None
        self._session.go(value)
        begin = self._listener.count
        survey.arrive(self._elapsed)
        while True:
            end = begin + (survey.windows + 1) * how.length
            self._session.wait_until(functools.partial(self._is_over, end))
            self._session.refuse_dead()
            if self._elapsed > rig.time:
                return False
            if survey.take(self._listener.samples(end - how.length, end).x):
                return True

    def _is_over(self, count: int) -> bool:
        return self._listener.count >= count or self._elapsed > self._rig.time

    # -- showing ------------------------------------------------------------------------------

    def _estimate_left(self) -> float:
        """Return how long it will still take [s]."""
        state, rig = self._state, self._rig
        assert state.how is not None
        durations = [visit.stay for visit in state.visits]
        mean = float(np.mean(durations)) if durations else GUESS * state.how.length * rig.dt
        visits = self._survey.visits_left
        travel = visits * rig.span / rig.theta_rate / (len(state.values) - 1) * 1.5
        return min(visits * mean + travel, self._time_left)

    def _print_forecast(self) -> None:
        rig, done = self._rig, len(self._state.visits)
        resumed = f"; {done} visits were done before" if done else ""
        least, most = (s / rig.pace for s in (self._estimate_left(), self._time_left))
        print(
            f"{len(self._state.values)} values of theta from {rig.theta_min:g} to "
            f"{rig.theta_max:g}, up and down, then in random order{resumed}: about "
            f"{_format_time(least)}, at most {_format_time(most)}, and up to "
            f"{_format_time(compute_return_time(rig, rig.theta_max))} back to "
            f"{rig.theta_safe:g}; Ctrl-C returns theta there",
            flush=True,
        )

    def _show(self) -> None:
        if self._state.how is None:
            return
        theta, left = self._session.commander.theta, self._estimate_left()
        self._bar.set_description_str(f"theta {theta:+.4g}", refresh=False)
        self._bar.total = self._elapsed + left
        self._bar.n = self._elapsed
        rest = f", {_format_time(left / self._rig.pace)} left" if self._state.visits else ""
        self._bar.set_postfix_str(f"{len(self._state.visits)} visits{rest}", refresh=True)


def format_map(rig: RigFile, state: Progress) -> str:
    """Return the static map as a table."""
    if not state.visits or state.how is None:
        return "theta was at no dwell point"
    names = state.how.names(rig.names)
    feature, points = state.map_of(range(len(names)))
    rows = []
    for level, (value, point) in enumerate(zip(state.values, points, strict=True)):
        if point is None:
            rows.append([f"{value:.4g}", "-", "-", "0", "-"])
            continue
        visits = [visit for visit in state.visits if visit.level == level]
        settled = f"{max(visit.settled for visit in visits):.3g}"
        error = "-" if math.isinf(point.error) else f"{100.0 * point.error:.2g} %"
        amplitude = f"{math.exp(point.mean):.4g}"
        rows.append([f"{value:.4g}", amplitude, error, str(len(visits)), settled])
    return f"amplitude of {names[feature]}, which shows theta most clearly\n" + table(
        ["theta", "amplitude", "error", "visits", "settled after [s]"], rows
    )


def _format_time(seconds: float) -> str:
    """Return a time in words.

    >>> _format_time(600.0)
    '10 min'
    """
    return f"{seconds:.0f} s" if seconds < 120.0 else f"{seconds / 60.0:.0f} min"
