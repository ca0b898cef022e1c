"""``koop excite``: moves theta over its range and records: the data to make a controller from."""

from __future__ import annotations

import argparse
import functools
import math
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from koop_bag.bag.columns import read_tables
from koop_bag.bag.reader import BagReader
from koop_bag.bag.recover import recover
from koop_bag.errors import BagError, DiskFullError
from koop_bag.recorder.run_folder import default_folder
from koop_bringup.live.loop import LiveNodes
from koop_commission.rig.listener import DISCOVERY
from koop_commission.stages import time_scale
from koop_commission.stages.session import Session, Watch, refuse_incomplete_state, session
from koop_commission.theta.commander_client import note_of
from koop_commission.theta.limits import way_home
from koop_core.config.parameter import ConfigError
from koop_core.errors import LiveError
from koop_core.text_table import table
from koop_tune.excitation import progress as progress_file
from koop_tune.excitation import staircase
from koop_tune.excitation.progress import Progress
from koop_tune.excitation.survey import SHORTEST, Survey
from koop_tune.rig import rig_file
from koop_tune.rig.rig_file import STATE, THETA, RigFile

GUESS = 12  # windows that theta stays at a value, before any was seen
BYTES = 250.0  # of a bag for one state, with its cost and theta
BAR = "{desc} |{bar}| {n:.0f}/{total:.0f} s{postfix}"


class Result(NamedTuple):
    """What an excitation came to.

    Attributes
    ----------
    progress : Progress
        All that was done.
    reason : str
        Why it ended, in words.
    """

    progress: Progress
    reason: str


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser(
        "excite",
        description="Moves theta over its range, up, down and at random, with the lifter on, and "
        "records everything. It stays at each value until the rig has settled and the amplitude "
        "is known, and ends when the whole map is. Whatever ends it, theta goes back to "
        "theta_safe at the permitted rate. The same command with the same --out goes on where it "
        "was interrupted.",
    )
    parser.add_argument("rig", metavar="RIG.YAML", help="of 'koop commission --new'")
    parser.add_argument(
        "--out", type=Path, metavar="DIR",
        help="folder of the recordings (default: recordings/TIME-NAME)",
    )  # fmt: skip
    time_scale.add_to(parser)
    parser.add_argument("--seed", type=int, default=0, help="of the random order")
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 0 if theta was at every value at least twice."""
    from koop_commission.report import reported  # slow to import

    rig = rig_file.read(args.rig)
    scale = time_scale.of(args)
    folder = args.out or default_folder(Path(args.rig).stem)
    again = f"./koop excite {args.rig} --out {folder}{time_scale.words(args)}"
    try:
        result = excite(rig, folder, scale, args.seed, note_of(args.rig))
    except LiveError as error:
        raise LiveError(f"{error}; to go on: {again}") from None
    except KeyboardInterrupt:
        print(f"\ninterrupted: theta is back at {rig.theta_safe:g}; to go on: {again}")
        return 130
    print("\n" + ending(rig, folder, result))
    print(reported(folder))
    print(f"now: ./koop tune {args.rig} {folder}")
    return 1 if staircase.unknown_twice(result.progress.visits, len(result.progress.values)) else 0


def ending(rig: RigFile, folder: Path, result: Result) -> str:
    """Return what an excitation came to, in words."""
    bags = [folder / part / "bag" for part in result.progress.parts]
    states, answered = np.sum([count_answers(bag) for bag in bags], axis=0)
    return (
        f"{shown(rig, result.progress)}\n\n{result.reason}; theta is back at {rig.theta_safe:g}\n"
        f"recorded {states} states, theta of {answered} of them"
    )


def count_answers(bag: Path) -> tuple[int, int]:
    """Return how many states a bag holds, and for how many of them a theta."""
    with BagReader(bag) as reader:
        recorded = {topic.name for topic in reader.topics if topic.count}
        if not recorded >= {STATE, THETA}:
            return 0, 0
        tables = read_tables(reader, {STATE: ["step"], THETA: ["step"]})
    states, thetas = (np.unique(tables[topic]["step"]) for topic in (STATE, THETA))
    return states.size, np.intersect1d(states, thetas).size


def excite(
    rig: RigFile,
    folder: Path,
    scale: float = 1.0,
    seed: int = 0,
    note: Path | None = None,
    check: Callable[[], object] = lambda: None,
    patience: float = DISCOVERY,
) -> Result:
    """Move theta over its range and record, until the static map is known or the time is over.

    Parameters
    ----------
    rig : RigFile
        The rig, which runs.
    folder : Path
        Of the recordings; what was begun there goes on.
    scale : float
        The rig's seconds in one second.
    seed : int
        Of the random order.
    note : Path, optional
        File that says where theta was left.
    check : callable
        Called once a second; it may raise LiveError.
    patience : float
        Time that the rig may take to be found [s].

    Raises
    ------
    koop_core.errors.LiveError
        If it ends before that: the rig, a node or the disk fails, a limit is crossed, somebody else
        commands. theta is at its safe value then.
    koop_core.config.parameter.ConfigError
        If the folder holds what was recorded of another rig, or all that was wanted.
    """
    refuse_incomplete_state(rig)
    known = progress_file.load(rig, folder)
    if known is not None and known.done:
        raise ConfigError(f"{folder}: the map is known already: choose another --out")
    state = known or progress_file.begin(seed, rig)
    refuse_small_disk(rig, folder, rig.time - state.elapsed)
    for part in state.parts:
        mend(folder / part / "bag")
    part = f"part-{len(state.parts) + 1}"
    while (folder / part).exists():  # of one that was killed before it was noted
        part = f"part-{int(part[5:]) + 1}"

    def began() -> None:
        state.parts.append(part)
        progress_file.save(state, rig, folder)

    watch = Watch(scale, note, check, patience)
    nodes = LiveNodes(folder / part, nodes_of(rig, folder / part), rig=True)
    with session("koop_excite", rig, watch, nodes, began) as own:
        return Excitation(rig, folder, scale, state, own).run()


def refuse_small_disk(rig: RigFile, folder: Path, seconds: float) -> None:
    """Refuse to begin where the disk has no room for a recording of some time."""
    there = folder
    while not there.exists():
        there = there.parent
    free = shutil.disk_usage(there).free
    needed = BYTES * max(seconds, 0.0) / rig.dt
    if free < needed:
        raise LiveError(
            f"{there}: {free / 1e6:.0f} MB are free, up to {needed / 1e6:.0f} MB are needed: make "
            "room, or set a shorter time in the rig file"
        )


def mend(bag: Path) -> None:
    """Make a whole bag of one that a full disk or a kill has torn.

    The torn one stays beside it if some of it could not be read.

    Raises
    ------
    koop_core.errors.LiveError
        If there is no room for that.
    """
    whole, torn = bag.with_name("bag-whole"), bag.with_name("bag-torn")
    shutil.rmtree(whole, ignore_errors=True)  # of a mending that was stopped itself
    if torn.exists() and not bag.exists():
        torn.rename(bag)
    try:
        with BagReader(bag) as reader:
            if reader.complete:
                return
        found = recover(bag, whole)
    except DiskFullError:
        shutil.rmtree(whole, ignore_errors=True)
        raise LiveError(
            f"{bag} is torn, and there is no room to make it whole: make room"
        ) from None
    except BagError:
        return  # of one that never got a message
    bag.rename(torn)
    whole.rename(bag)
    kept = f"; what could not be read is in {torn.name}" if found.damaged_records else ""
    if not kept:
        shutil.rmtree(torn)
    print(f"{bag} was torn: made whole, {found.messages} messages{kept}")


def nodes_of(rig: RigFile, folder: Path) -> dict[str, dict[str, Any]]:
    """Return the nodes that run beside, with their parameters."""
    lifter = {"cost": "raw", "dt": rig.dt, "recorders": 0, **rig.lifter_input}
    return {"recorder": {"output": str(folder)}, "koopman_lifter": lifter}


class Excitation:
    """One part of an excitation, from its first state to its end.

    Parameters
    ----------
    rig : RigFile
        The rig.
    folder : Path
        Of all parts.
    scale : float
        The rig's seconds in one second.
    state : Progress
        What was done; it grows.
    own : Session
        With the rig.
    """

    def __init__(
        self, rig: RigFile, folder: Path, scale: float, state: Progress, own: Session
    ) -> None:
        self._rig = rig
        self._folder = folder
        self._scale = scale
        self._state = state
        self._own = own
        self._ears = own.ears
        self._survey = Survey(rig, state)
        self._begin, self._before, self._began = 0, state.elapsed, time.monotonic()
        self._bar = tqdm(bar_format=BAR, leave=False, disable=None, total=1.0)
        own.shown = self._show

    @property
    def _elapsed(self) -> float:
        """Time of all parts [s]; of the rig's own."""
        if getattr(self._ears.last, "lockstep", False):
            return self._before + (self._ears.count - self._begin) * self._rig.dt
        return self._before + (time.monotonic() - self._began) * self._scale

    @property
    def _time_left(self) -> float:
        """Time of the rig file that is left [s]."""
        return max(self._rig.time - self._elapsed, 0.0)

    # -- moving -------------------------------------------------------------------------------

    def run(self) -> Result:
        """Move theta until the map is known or the time is over."""
        state, rig = self._state, self._rig
        self._begin, self._began = self._ears.count, time.monotonic()
        if state.how is None:
            self._listen()
        assert state.how is not None
        self._own.still = state.how.length
        self._forecast()
        reason = "the static map is known well enough"
        while (value := self._survey.next_value()) is not None:
            if not self._stay(value):
                reason = f"the {rig.time:g} s of the rig file are over"
                break
            state.elapsed = self._elapsed
            progress_file.save(state, rig, self._folder)
        state.elapsed = self._elapsed
        progress_file.save(state, rig, self._folder)
        self._bar.close()
        return Result(state, reason)

    def _listen(self) -> None:
        """Choose the windows from what the rig does before theta moves."""
        dt = self._rig.dt

        heard = 0

        def more() -> bool:
            return self._ears.count >= heard + 0.2 * SHORTEST / dt

        while self._survey.listens(x := self._ears.samples(self._begin).x):
            heard = self._ears.count
            self._own.until(more)
        try:
            found = self._survey.look(x)
        except ValueError as error:
            raise LiveError(str(error)) from None
        assert self._state.how is not None
        print(
            f"periods from {min(found):.3g} to {found.slowest:.3g} s: amplitudes are taken in "
            f"windows of {self._state.how.length * dt:.3g} s",
            flush=True,
        )

    def _stay(self, value: float) -> bool:
        """Go to a value and stay as long as it needs; return False if the time is over."""
        rig, how, survey = self._rig, self._state.how, self._survey
        assert how is not None
        self._own.go(value)
        begin = self._ears.count
        survey.arrive(self._elapsed)
        while True:
            end = begin + (survey.windows + 1) * how.length
            self._own.until(functools.partial(self._heard_or_over, end))
            self._own.refuse_dead()
            if self._elapsed > rig.time:
                return False
            if survey.take(self._ears.samples(end - how.length, end).x):
                return True

    def _heard_or_over(self, count: int) -> bool:
        return self._ears.count >= count or self._elapsed > self._rig.time

    # -- telling ------------------------------------------------------------------------------

    def _left(self) -> float:
        """Return how long it is going to take yet [s]."""
        state, rig = self._state, self._rig
        assert state.how is not None
        length = state.how.length * rig.dt
        stays = [visit.stay for visit in state.visits]
        stay = float(np.mean(stays)) if stays else GUESS * length
        visits = self._survey.visits_left
        travel = visits * rig.span / rig.theta_rate / (len(state.values) - 1) * 1.5
        return min(visits * stay + travel, self._time_left)

    def _forecast(self) -> None:
        rig, home = self._rig, way_home(self._rig, self._rig.theta_max)
        done = len(self._state.visits)
        again = f"; {done} stays were done before" if done else ""
        print(
            f"{len(self._state.values)} values of theta from {rig.theta_min:g} to "
            f"{rig.theta_max:g}, up and down, then at random{again}: about "
            f"{_time(self._left() / self._scale)}, at most "
            f"{_time(self._time_left / self._scale)}, and up to "
            f"{_time(home / self._scale)} back to {rig.theta_safe:g}; Ctrl-C ends it there",
            flush=True,
        )

    def _show(self) -> None:
        if self._state.how is None:
            return
        self._bar.set_description_str(f"theta {self._own.hand.theta:+.4g}", refresh=False)
        self._bar.total = self._elapsed + self._left()
        self._bar.n = self._elapsed
        left = f", {_time(self._left() / self._scale)} left" if self._state.visits else ""
        self._bar.set_postfix_str(f"{len(self._state.visits)} stays{left}", refresh=True)


def shown(rig: RigFile, state: Progress) -> str:
    """Return the static map as a table."""
    if not state.visits or state.how is None:
        return "no value of theta was reached"
    names = state.how.names(rig.names)
    feature, points = state.map_of(range(len(names)))
    rows = []
    for level, (value, point) in enumerate(zip(state.values, points, strict=True)):
        if point is None:
            rows.append([f"{value:.4g}", "-", "-", "0", "-"])
            continue
        own = [visit for visit in state.visits if visit.level == level]
        settled = max(visit.settled for visit in own)
        error = "-" if math.isinf(point.error) else f"{100.0 * point.error:.2g} %"
        rows.append(
            [f"{value:.4g}", f"{math.exp(point.mean):.4g}", error, str(len(own)), f"{settled:.3g}"]
        )
    return f"amplitude of {names[feature]}, in which theta shows most\n" + table(
        ["theta", "amplitude", "error", "stays", "settled after [s]"], rows
    )


def _time(seconds: float) -> str:
    """Return a time in words.

    >>> _time(600.0)
    '10 min'
    """
    return f"{seconds:.0f} s" if seconds < 120.0 else f"{seconds / 60.0:.0f} min"
