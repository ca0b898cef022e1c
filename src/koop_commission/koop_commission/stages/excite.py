"""``koop excite``: moves theta over its range and records, to make a controller from it."""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path
from typing import Any

from koop_bag.recorder.run_folder import default_folder
from koop_bringup.live.loop import LiveNodes
from koop_commission.stages.session import Session, open_session, refuse_small_disk, resumable
from koop_commission.theta.commander_client import note_of
from koop_commission.theta.limits import compute_return_time
from koop_core.config.parameter import ConfigError
from koop_core.errors import KoopError, LiveError
from koop_tune.excitation import progress as progress_file
from koop_tune.excitation.progress import ExcitationProgress
from koop_tune.excitation.survey import SURVEY, Survey
from koop_tune.rig import rig_file
from koop_tune.rig.rig_file import RigFile


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
    with resumable(rig, f"./koop excite {args.rig} --out {folder}"):
        progress = excite(rig, folder, note_of(args.rig))
    print("\n" + describe_result(rig, progress))
    print(try_report(folder))
    print(f"next: ./koop tune {args.rig} {folder}")
    return 1 if progress.lacks_visits else 0


def describe_result(rig: RigFile, progress: ExcitationProgress) -> str:
    """Return in words why an excitation ended, and how much of it is known."""
    reason = (
        "the static map is known well enough" if progress.done
        else f"the {rig.time:g} s of the rig file are over"
    )  # fmt: skip
    reached = f"{len(progress.reached)} of {len(progress.values)} dwell points"
    return (
        f"{reason}: {len(progress.visits)} visits of {reached} in {progress.elapsed:.0f} s; theta "
        f"is back at {rig.theta_safe:g}"
    )


def excite(
    rig: RigFile, folder: Path, note: Path | None = None, seed: int = 0
) -> ExcitationProgress:
    """Move theta over its range and record, until the static map is known or the time is over.

    Parameters
    ----------
    rig : RigFile
        The rig, which runs.
    folder : Path
        Folder of the recordings; an excitation that was begun there is resumed.
    note : Path, optional
        File that notes where theta was left.
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
    state = progress_file.load(rig, folder) or progress_file.begin(seed, rig)
    if state.done:
        raise ConfigError(f"{folder}: the static map is known already: choose another --out")
    refuse_small_disk(rig, folder, rig.time - state.elapsed)
    number = len(state.parts) + 1
    while (folder / (part := f"part-{number}")).exists():  # of one killed before it was noted
        number += 1

    lifter = {"cost": "raw", "dt": rig.dt, "listeners": "recorder", **rig.lifter_input}
    recorder = {"output": str(folder / part)}
    parameters: dict[str, dict[str, Any]] = {"recorder": recorder, "koopman_lifter": lifter}
    nodes = LiveNodes(folder / part, parameters, rig=True)
    with open_session("koop_excite", rig, nodes, note) as session:
        state.parts.append(part)
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
    state : ExcitationProgress
        Done so far; it grows.
    session : Session
        With the rig.
    """

    def __init__(
        self, rig: RigFile, folder: Path, state: ExcitationProgress, session: Session
    ) -> None:
        self._rig, self._folder, self._state, self._session = rig, folder, state, session
        self._listener = session.listener
        self._survey = Survey(rig, state)
        self._first, self._before, self._began = (
            self._listener.count,
            state.elapsed,
            time.monotonic(),
        )
        session.show = self._show

    @property
    def _elapsed(self) -> float:
        """Time of all parts [s], of the rig's own time."""
        if getattr(self._listener.last, "lockstep", False):
            return self._before + (self._listener.count - self._first) * self._rig.dt
        return self._before + (time.monotonic() - self._began) * self._rig.pace

    def run(self) -> None:
        """Move theta until the map is known or the time is over."""
        state = self._state
        self._save()
        if state.bands is None:
            self._listen()
        assert state.bands is not None
        self._session.still = state.bands.length
        self._print_forecast()
        while (value := self._survey.next_value()) is not None and self._dwell(value):
            self._save()
        self._save()

    def _save(self) -> None:
        self._state.elapsed = self._elapsed
        progress_file.save(self._state, self._rig, self._folder)

    def _listen(self) -> None:
        """Choose the windows from the oscillation before theta moves."""
        dt = self._rig.dt
        while self._survey.listens(x := self._listener.samples(self._first).x):
            self._session.wait_for_states(math.ceil(0.2 * SURVEY.shortest / dt))
        try:
            periods = self._survey.look(x)
        except KoopError as error:
            raise LiveError(str(error)) from None
        assert self._state.bands is not None
        print(
            f"periods from {min(periods):.3g} to {periods.slowest:.3g} s: amplitudes are taken in "
            f"windows of {self._state.bands.length * dt:.3g} s",
            flush=True,
        )

    def _dwell(self, value: float) -> bool:
        """Hold theta at a dwell point as long as it needs; return False if the time is over."""
        survey, bands, listener = self._survey, self._state.bands, self._listener
        assert bands is not None
        self._session.go(value)
        begin = end = listener.count
        survey.arrive(self._elapsed)

        def is_over() -> bool:
            return listener.count >= end or self._elapsed > self._rig.time

        while True:
            end = begin + (survey.windows + 1) * bands.length
            self._session.wait_until(is_over)
            self._session.refuse_dead()
            if self._elapsed > self._rig.time:
                return False
            if survey.take(listener.samples(end - bands.length, end).x):
                return True

    def _print_forecast(self) -> None:
        rig, done = self._rig, len(self._state.visits)
        resumed = f"; {done} visits were done before" if done else ""
        most = max(rig.time - self._elapsed, 0.0) / rig.pace / 60.0
        back = compute_return_time(rig, rig.theta_max)
        print(
            f"{len(self._state.values)} values of theta from {rig.theta_min:g} to "
            f"{rig.theta_max:g}, up and down, then in random order{resumed}: at most {most:.0f} "
            f"min, and up to {back:.0f} s back to {rig.theta_safe:g}; Ctrl-C returns theta there",
            flush=True,
        )

    def _show(self) -> None:
        visits = f"{len(self._state.visits)} visits, {self._survey.visits_left} or more to go"
        self._session.draw("exciting", self._elapsed, self._rig.time, visits)
