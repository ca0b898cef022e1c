"""``koop excite``: moves theta over its range and records, to make a controller from it."""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from koop_bag.recorder.run_folder import default_folder
from koop_bringup.live.loop import LiveNodes
from koop_bringup.plan import Plan
from koop_commission.rig.guarded_theta import GUARD, guard_remaps, guard_section
from koop_commission.stages.safe_range import find_safe_range
from koop_commission.stages.session import (
    Session,
    open_session,
    refuse_small_disk,
    resumable,
    spell_time,
)
from koop_core.config.knobs import format_knobs
from koop_core.config.parameter import ConfigError
from koop_core.errors import KoopError, LiveError
from koop_guard.note import note_of
from koop_tune.excitation import progress as progress_file
from koop_tune.excitation.design import DESIGN, FLAT, KNOWN, TIME
from koop_tune.excitation.holds import spell_error
from koop_tune.excitation.knobs_design import KnobsDesign, KnobsMove, RecordedHold
from koop_tune.excitation.progress import ExcitationProgress, HoldSummary, SectionLine, round_up
from koop_tune.rig import rig_file
from koop_tune.rig.rig_file import RigFile
from koop_tune.rig_model.dwells import DWELLS
from koop_tune.tune_folders import list_bags, load_since

ENOUGH = 0.8  # share of a hold that was recorded, of which lost messages cut the rest


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser(
        "excite",
        description="Moves theta over its range and then to where it tells most about the least "
        "amplitude and its surroundings, and records everything. theta is held until the rig has "
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
    """Entry point; returns the exit code: 0 if the static map is known."""
    from koop_commission.report import try_report  # slow to import

    rig = rig_file.read(args.rig)
    folder = args.out or default_folder(Path(args.rig).stem)
    with resumable(rig, f"./koop excite {args.rig} --out {folder}"):
        progress = excite(rig, folder, note_of(args.rig))
    print("\n" + describe_result(rig, progress))
    print(try_report(folder))
    if progress.ended == KNOWN:
        print(f"next: ./koop tune {args.rig} {folder}")
        return 0
    return 1


def describe_result(rig: RigFile, progress: ExcitationProgress) -> str:
    """Return in words why an excitation ended, and how much of it is known."""
    reason = {
        KNOWN: "the static map is known well enough",
        FLAT: "nothing reacts to theta beyond the errors: 'koop check' tells whether theta reaches "
        "the rig",
    }.get(progress.ended) or progress.describe_end(rig)
    if rig.count == 1 and progress.ended == KNOWN and len(progress.holds) >= DESIGN.most:
        reason = "as many holds as are made, after which more would show little"
    return (
        f"{reason}; {len(progress.done)} holds in {progress.elapsed:.0f} s of the rig's time; "
        f"theta is back at {rig.spell('theta_safe')}"
    )


def excite(rig: RigFile, folder: Path, note: Path | None = None) -> ExcitationProgress:
    """Move theta over its range and record, until the static map is known or the time is over.

    An excitation that was begun in the folder is resumed; ``note`` is the file that notes where
    theta was left.

    Raises
    ------
    koop_core.errors.LiveError
        If it ends early: the rig, a node or the disk fails, a limit is crossed, another publisher
        commands theta. theta is at theta_safe then.
    koop_core.config.parameter.ConfigError
        If the folder holds the recordings of another rig, or a finished excitation.
    """
    state = progress_file.load(rig, folder) or ExcitationProgress()
    if state.ended in (KNOWN, FLAT):
        raise ConfigError(f"{folder}: the static map is known already: choose another --out")
    if state.elapsed >= rig.time:
        raise ConfigError(f"{folder}: {state.describe_end(rig)}")
    refuse_small_disk(rig, folder, rig.time - state.elapsed)
    recorded, state.ended = read_holds(state.narrow(rig), folder, state), ""
    number = len(state.parts) + 1
    while (folder / (part := f"part-{number}")).exists():  # of one killed before it was noted
        number += 1

    lifter = {"cost": "raw", "listeners": "recorder", **rig.lifter_input}
    recorder = {"output": str(folder / part)}
    parameters: dict[str, dict[str, Any]] = {
        "recorder": recorder, "koopman_lifter": lifter, GUARD: guard_section(rig, note),
    }  # fmt: skip
    nodes = LiveNodes(folder / part, Plan(parameters, rig=True, remaps=guard_remaps(rig)))
    with open_session(rig, nodes, note) as session:
        state.parts.append(part)
        if rig.bounded is not None and state.safe is None:
            begun = session.listener.count
            state.safe = find_safe_range(rig, rig.bounded, session)
            state.elapsed += (session.listener.count - begun) * rig.dt
        Excitation(state.narrow(rig), folder, state, recorded, session).run()
    return state


class Excitation:
    """One part of an excitation, from its first state to its end.

    ``state`` is what was done so far, and grows; ``recorded`` the same, as recorded.
    """

    def __init__(
        self, rig: RigFile, folder: Path, state: ExcitationProgress, recorded: list[RecordedHold],
        session: Session,
    ) -> None:  # fmt: skip
        self._rig, self._folder, self._state, self._session = rig, folder, state, session
        self._listener = session.listener
        self._first, self._before = self._listener.count, state.elapsed
        self._began = time.monotonic()
        self._design = KnobsDesign(rig, recorded=recorded)
        self._said = math.inf  # log amplitude of the last line, in the unit of then
        session.show = self._show

    @property
    def _elapsed(self) -> float:
        """Time of all parts [s] of the rig, which may fall behind its pace if it is simulated."""
        passed = self._listener.count_steps(self._first) * self._rig.dt
        if not getattr(self._listener.last, "lockstep", False):  # a clock that is set may leap
            passed = min(passed, (time.monotonic() - self._began) * self._rig.pace)
        return self._before + passed

    def run(self) -> None:
        """Move theta until the map is known or the time is over."""
        progress_file.save(self._state, self._rig, self._folder)
        if self._state.done:
            tqdm.write(f"{len(self._state.done)} holds were done before")
        self._listen()
        move = self._design.next()
        self._forecast()
        while move is not None and self._hold(move):
            self._report_hold(move)
            self._save()
            move = self._design.next()
        self._state.ended = self._design.ended or TIME
        self._save()

    def _save(self) -> None:
        state, design, rig = self._state, self._design, self._rig
        state.since = max(state.since, design.since)
        state.windows, state.amplitude = design.windows, design.amplitude
        self._note_time()
        seconds, dt = design.windows.seconds, self._rig.dt
        holds = [
            HoldSummary(
                rig.theta_at(u), level.mean, min(level.error, 10.0), level.skip * seconds,
                hold.x.shape[0] * dt, hold.why,
            )
            for (hold, u), level in zip(design.held, design.levels(), strict=True)
        ]  # fmt: skip
        state.set_holds(rig, holds)
        state.sections = [SectionLine(k, rig.theta_at(u)) for k, u in design.lines.items()]
        progress_file.save(state, self._rig, self._folder)

    def _note_time(self) -> None:
        self._state.elapsed = self._elapsed
        self._state.needed = self._elapsed + self._design.needed[1]

    def _listen(self) -> None:
        """Choose the first windows from the oscillation before theta moves."""
        dt, theta = self._rig.dt, format_knobs(self._session.theta.value, ".4g")
        tqdm.write(f"listening before theta moves, at theta = {theta}")
        while self._design.listens(x := self._listener.samples(self._first).x):
            self._session.wait_for_states(math.ceil(0.2 * DESIGN.shortest / dt), "listening")
        try:
            shortest, longest = self._design.look(x)
        except KoopError as error:
            raise LiveError(str(error)) from None
        # a channel's own noise moves its line by some thousandths
        span = " to ".join(dict.fromkeys(f"{period:.2g}" for period in (shortest, longest)))
        tqdm.write(f"periods of {span} s; which of them react shows as theta moves")

    def _forecast(self) -> None:
        """Say how long it takes at least, before theta moves.

        Raises
        ------
        koop_core.config.parameter.ConfigError
            If the time of the rig file is too short for that, and nothing was done before: a user
            who did as an interrupted one said is not sent away with another figure.
        """
        rig, (first_holds, whole) = self._rig, self._design.needed
        left = max(rig.time - self._elapsed, 0.0)
        self._note_time()
        if first_holds > left and not self._state.done:
            raise ConfigError(
                f"the first holds alone need {first_holds:.0f} s, and of time = {rig.time:g} in "
                f"the rig file {left:.0f} s are left: {self._state.longer}"
            )
        back = max(rig.guard.return_time(rig.each(name)) for name in ("theta_min", "theta_max"))
        several = ", one knob after another" * (rig.count > 1)
        first = f"between {rig.spell('theta_min')} and {rig.spell('theta_max')}{several}, "
        first += "there and back, then "
        needed = ""
        if whole <= left:
            needed = f"at least {round_up(whole):g} s if what was heard is what it moves, "
        else:
            tqdm.write(
                f"time = {rig.time:g} in the rig file is too short for the whole map: once it is "
                f"over, {self._state.longer} and run the same command again",
            )
        tqdm.write(
            f"theta goes {first * (self._design.left > 0)}to where it tells most about the best "
            f"value: {needed}at most {spell_time(left, rig.pace)}; "
            f"Ctrl-C ends it, theta returns to {rig.spell('theta_safe')} within {back:.2g} s here\n"
            "[s] of the rig's time; amplitude in units of each channel's strongest motion so far",
        )

    def _hold(self, move: KnobsMove) -> bool:
        """Hold theta as long as it needs; return False if the time is over."""
        design, listener = self._design, self._listener
        for u in (move.via, move.u):
            if u is not None:
                self._session.go(self._rig.theta_at(u))
        begin = end = listener.count
        design.arrive(move, self._elapsed)

        def is_over() -> bool:
            return listener.count >= end or self._elapsed > self._rig.time

        while True:
            end = begin + design.windows.length
            self._session.still = design.windows.length
            self._session.show = self._show
            self._session.wait_until(is_over)
            self._session.refuse_dead()
            if self._elapsed > self._rig.time:
                return False
            if design.take(listener.samples(begin, end).x):
                return True
            begin = end

    def _report_hold(self, move: KnobsMove) -> None:
        """Say what a hold showed, and what reacts once that is known or changes."""
        design, rig = self._design, self._rig
        theta, held = format_knobs(rig.theta_at(move.u), ".4g"), design.held
        at = f"{self._elapsed:6.0f} s  theta {theta:<9} held "
        if not any((u == move.u).all() for _, u in held):
            seconds = design.windows.seconds
            tqdm.write(f"{at}too short for windows of {seconds:.3g} s: again later")
            return
        hold, amplitude = held[-1][0], design.amplitude
        said = f"{at}{hold.size * rig.dt:4.0f} s  amplitude "
        if amplitude is None:
            tqdm.write(f"{said}unknown: nothing reacts yet  ({move.why})")
            return
        *before, level = design.levels()
        if before and abs(before[-1].mean - self._said) > DESIGN.redefined + before[-1].error:
            tqdm.write(
                f"from here the amplitude is that of {amplitude.name(rig.names)}, in other "
                f"units than above: the hold before has {math.exp(before[-1].mean):.3g}"
            )
        self._said = level.mean
        error = spell_error(level.error)
        tqdm.write(f"{said}{math.exp(level.mean):<7.3g} +- {error:<6}  ({move.why})")

    def _show(self) -> None:
        holds = f"{len(self._design.held)} holds, {self._design.left} or more to go"
        self._session.draw("exciting", self._elapsed, self._rig.time, holds)


def read_holds(rig: RigFile, folder: Path, state: ExcitationProgress) -> list[RecordedHold]:
    """Return the holds that an interrupted excitation recorded."""
    if not state.done:
        return []
    loaded, _ = load_since(list_bags(folder, rig, state), rig, state)
    assert loaded.theta is not None
    u, recorded = rig.u(loaded.theta.reshape(-1, rig.count)), []
    for hold in state.done:
        on = np.abs(u - rig.u(hold.theta)).max(axis=1) < DWELLS.same
        edges = np.flatnonzero(np.diff(np.r_[False, on, False].astype(np.int8)))
        for begin, after in edges.reshape(-1, 2):
            if (after - begin) * rig.dt >= ENOUGH * hold.seconds:
                x, u[begin:after] = loaded.x[:, begin:after].T, np.nan  # no other hold's
                recorded.append(RecordedHold(rig.u(hold.theta), x, state.since + begin * rig.dt))
                break
    return sorted(recorded, key=lambda hold: hold.elapsed)
