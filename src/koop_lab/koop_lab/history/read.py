"""Records of a loop's runs: the long-term record, and the bag where that ends."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from koop_bag.bag.columns import iter_tables
from koop_bag.bag.earlier import label_of
from koop_bag.bag.reader import BagReader
from koop_bag.bag.summary import FIELDS, SECOND, LoopSecond, Seconds
from koop_bag.errors import BagError
from koop_core.config.fields import parse_source
from koop_core.config.knobs import MOST
from koop_core.ended import Ended, read_end
from koop_core.errors import InputError, KoopError
from koop_guard.guard import Status
from koop_identify.recording.recorded_parameters import recorded_values
from koop_lab.history.seconds import (
    COLUMNS,
    Rows,
    from_columns,
    from_seconds,
    gather,
    join,
    with_guard,
)

BAG, SUMMARY, LOGS = "bag", "summary", "logs"
GUARD_STATE = "koop_msgs/msg/GuardState"
GUARD = (
    "log_time", "header.stamp", "tripped_at", "status", "cause", "reason",
    *(f"{name}[{k}]" for name in ("theta", "tripped_theta") for k in range(MOST)),
)  # fmt: skip
HEALTH = ("log_time", "status[0].name", "status[0].level", "status[0].message")
CLOCK_SET = 946_684_800  # [s since the epoch], the year 2000: a clock that shows less was not set
LONG, SHORT, FINE = 7200.0, 10.0, 60.0  # [s]: within a span of LONG, amplitudes of SHORT, or FINE


class GuardMessage(NamedTuple):
    """A guard's message: time [s since the epoch], status as in GuardState, why, theta.

    ``tripped`` is the time of the trip [s since the epoch]; that of the message where it is not
    known.
    """

    time: float
    status: int
    cause: str
    reason: str
    theta: tuple[float, ...]
    tripped_theta: tuple[float, ...]
    tripped: float


class HealthMessage(NamedTuple):
    """Level of a node on /diagnostics, from a time on [s since the epoch]."""

    time: float
    node: str
    level: int
    text: str


@dataclass
class RunSpan:
    """A recording: when it began and ended [s since the epoch], and whether it was closed."""

    folder: Path
    begin: float
    end: float
    closed: bool
    ended: Ended | None = None
    """What the run noted of its end; None: nothing, as of ``ros2 launch``."""
    simulated: bool = False
    """Whether its plant was the simulated one."""


@dataclass
class History:
    """A loop, over all runs."""

    name: str
    """Namespace, without a slash at its end."""
    channels: tuple[str, ...]
    """Names of the measured channels."""
    rows: Rows
    """Intervals, in order of time."""
    runs: list[RunSpan]
    guard: list[GuardMessage]
    health: list[HealthMessage]
    models: list[tuple[float, str]]
    """Time [s since the epoch] from which on a model served the cost."""
    damaged: list[str]
    """In words, recordings that were left out, or could not be read to their end."""


@dataclass
class _Parts:
    """Parts gathered while runs are read, by loop or topic."""

    width: float = SHORT
    start: int = 0
    rows: dict[str, list[Rows]] = field(default_factory=dict)
    guard: dict[tuple[str, float], GuardMessage] = field(default_factory=dict)
    health: dict[tuple[str, float], HealthMessage] = field(default_factory=dict)
    models: dict[str, list[tuple[float, str]]] = field(default_factory=dict)
    channels: dict[str, tuple[str, ...]] = field(default_factory=dict)
    damaged: dict[Path, str] = field(default_factory=dict)

    @contextmanager
    def note_damage(self, bag: Path) -> Iterator[None]:
        """Note where a bag turns out to be damaged: the others are reported."""
        try:
            yield
        except BagError as error:
            why = f"{bag} is left out, or a part of it: {error}"
            made = f"what './koop bag recover {bag}' makes of it is read in its place"
            self.damaged.setdefault(bag, f"{why}; {made}")

    def add(self, loop: str, rows: Rows, models: Sequence[str]) -> None:
        """Take seconds of a loop."""
        rows = rows.since(self.start * 1e-9)
        models = models[len(models) - rows.time.size :]
        if not rows.time.size:
            return
        if guard := self.guard_of(loop):
            time, theta = np.array([m.time for m in guard]), np.array([m.theta for m in guard])
            rows = with_guard(
                rows, time, theta, np.array([m.status == Status.TRIPPED for m in guard])
            )
        self.rows.setdefault(loop, []).append(gather(rows, self.width))
        changes = self.models.setdefault(loop, [])
        for time, model in zip(rows.time.tolist(), models, strict=True):
            if model and (not changes or changes[-1][1] != model):
                changes.append((time, model))

    def guard_of(self, loop: str) -> list[GuardMessage]:
        """Return what the guard of a loop said, in order."""
        return sorted(m for (topic, _), m in self.guard.items() if topic.rsplit("/", 2)[0] == loop)


def read_history(paths: Sequence[Path], since: float | None = None) -> list[History]:
    """Read the runs of a loop, or of several namespaces, as far as their bags are whole.

    Parameters
    ----------
    paths : sequence of Path
        Folders of runs, or folders that hold such folders, at any depth.
    since : float, optional
        Only so many seconds before the end of the last one.

    Raises
    ------
    koop_core.errors.InputError
        If there is no recording that can be read, or if runs are of loops of other names.
    """
    parts = _Parts()
    runs = [_look_at(folder, parts) for folder in find_runs(paths)]
    runs = sorted((run for run in runs if run.end > 0.0), key=lambda run: run.begin)
    if not runs:
        raise _refuse(f"{paths[0]}: holds no recording with a message in it", parts)
    simulated = [run for run in runs if run.simulated]
    if len(simulated) < len(runs):
        _leave_out(simulated, "its plant is simulated, that of others is a rig", runs, parts)
    end = max(run.end for run in runs)
    unset = [run for run in runs if run.end < CLOCK_SET < end]
    _leave_out(unset, "its clock was not set", runs, parts)
    start = math.floor(min(run.begin for run in runs) if since is None else end - since)
    runs = [replace(run, begin=max(run.begin, start)) for run in runs if run.end > start]
    parts.width, parts.start = SHORT if end - start < LONG else FINE, start * SECOND
    for run in runs:
        _read_run(run, parts)
    if not parts.rows:
        raise _refuse(f"{paths[0]}: its recordings hold no state of a loop", parts)
    return [_make_history(loop, parts, runs) for loop in sorted(parts.rows)]


def find_runs(paths: Sequence[Path]) -> list[Path]:
    """Return the folders of runs; loops of different names are refused."""
    folders: list[Path] = []
    for path in paths:
        if not path.is_dir():
            raise InputError(f"{path}: is not a folder: name the folder of a run, or of runs")
        single = [path] if (path / BAG).is_dir() else []
        runs = single or sorted(bag.parent for bag in path.rglob(BAG) if bag.is_dir())
        if not runs:
            raise InputError(f"{path}: holds no run, a folder with a {BAG} in it")
        folders += runs
    names = {label for folder in folders if (label := label_of(folder.resolve()))}
    if len(names) > 1:
        raise InputError(
            f"{paths[0]}: holds runs of {', '.join(sorted(names)[:5])}: name the folders of one, "
            f"such as {paths[0]}/*-{min(names)}"
        )
    return folders


def _refuse(why: str, parts: _Parts) -> InputError:
    return InputError("; ".join([why, *[*parts.damaged.values()][:1]]))


def _leave_out(some: list[RunSpan], why: str, runs: list[RunSpan], parts: _Parts) -> None:
    """Take some of the runs out, and note why."""
    for run in some:
        parts.damaged[run.folder] = f"{run.folder} is left out, {why}: name its folder alone"
        runs.remove(run)


def _find_whole(bag: Path) -> Path:
    """Return a bag, or what ``koop bag recover`` has made of it since it was last written."""
    recovered = bag.with_name(f"{bag.name}_recovered")
    last = max((file.stat().st_mtime for file in bag.glob("*.mcap")), default=math.inf)
    return recovered if recovered.is_dir() and recovered.stat().st_mtime > last else bag


def _look_at(folder: Path, parts: _Parts) -> RunSpan:
    begin, end, closed, simulated = np.inf, 0.0, True, False
    for name in (SUMMARY, BAG):
        path = _find_whole(folder / name)
        if not any(path.glob("*.mcap*")):  # a later run's ring may have dropped them
            continue
        with parts.note_damage(path), BagReader(path) as bag:
            if bag.message_count:
                first, last = bag.start_time, bag.end_time
                if first < CLOCK_SET * SECOND < last:  # it was set meanwhile
                    first = next(bag.messages(start=CLOCK_SET * SECOND)).log_time
                begin, end = min(begin, first * 1e-9), max(end, last * 1e-9)
            closed = bag.complete
            simulated |= any(node.endswith("/vdp_plant") for node in bag.parameters)
    ended = None
    with suppress(KoopError):  # it is torn: then nothing is known
        ended = read_end(folder / LOGS)
    return RunSpan(folder, begin, end, closed, ended, simulated)


def _read_run(run: RunSpan, parts: _Parts) -> None:
    start = parts.start
    path = _find_whole(run.folder / SUMMARY)
    if path.is_dir():
        with parts.note_damage(path), BagReader(path) as bag:
            with parts.note_damage(path):
                _read_events(bag, parts, start)
            tables = {
                topic.name: COLUMNS
                for topic in bag.topics
                if topic.type_name == "koop_msgs/msg/LoopSummary" and topic.count
            }
            for topic, columns in iter_tables(bag, tables, start=start):
                loop = topic.rpartition("/")[0]
                parts.add(loop, from_columns(columns), columns["model_id"].tolist())
                start = max(start, int(columns["header.stamp"][-1]) + SECOND)
    path = _find_whole(run.folder / BAG)
    if not any(path.glob("*.mcap*")):
        return
    with parts.note_damage(path), BagReader(path) as bag:
        with parts.note_damage(path):
            _read_events(bag, parts, start)
        seconds: dict[str, list[LoopSecond]] = {}
        with parts.note_damage(path):
            _take_seconds(bag, start, seconds)
        for loop, of_loop in seconds.items():
            parts.add(loop, from_seconds(of_loop), [second.model_id for second in of_loop])
        for loop in parts.rows.keys() - parts.channels.keys():
            with suppress(KoopError, KeyError):
                values = recorded_values(bag, loop or "/")
                source = parse_source(str(values["koopman_lifter"]["measured"]))
                parts.channels[loop] = source.names


def _take_seconds(bag: BagReader, start: int, seconds: dict[str, list[LoopSecond]]) -> None:
    """Append the seconds of each loop, from a time on, out of a recording at full rate."""
    made, channels = Seconds(), {}
    for number, topic in enumerate(bag.topics):
        if topic.type_name in FIELDS and topic.count:
            made.watch(number, topic.name, topic.type_name, topic.definition)
            channels[topic.name] = number

    def take(finished: Iterator[LoopSecond]) -> None:
        for second in finished:
            seconds.setdefault(second.loop, []).append(second)

    last = 0
    for message in bag.messages(channels, start):
        made.add(channels[message.topic], message.log_time, message.data)
        if message.log_time > last + SECOND:
            last = message.log_time
            take(made.finish(last))
    take(made.finish())


def _read_events(bag: BagReader, parts: _Parts, start: int) -> None:
    tables = {
        topic.name: GUARD if topic.type_name == GUARD_STATE else HEALTH
        for topic in bag.topics
        if topic.count and (topic.type_name == GUARD_STATE or topic.name == "/diagnostics")
    }
    for name, columns in iter_tables(bag, tables, start=start):
        fields = tables[name]
        for stamp, *values in zip(*(columns[item].tolist() for item in fields), strict=True):
            time = stamp * 1e-9
            if stamp < start:
                continue
            if fields is GUARD:
                now, tripped_at, status, cause, reason, *theta = values
                then = time - (now * 1e-9 - tripped_at) if now and tripped_at else time
                at = tuple(theta[:MOST]), tuple(theta[MOST:])
                message = GuardMessage(time, status, cause, reason, *at, then)
                parts.guard.setdefault((name, time), message)
            elif isinstance(node := values[0], str):
                parts.health.setdefault((node, time), HealthMessage(time, node, *values[1:]))


def _make_history(loop: str, parts: _Parts, runs: list[RunSpan]) -> History:
    rows = join(parts.rows[loop])
    known = np.flatnonzero(np.isfinite(rows.theta).any(axis=(0, 1)))
    rows = replace(rows, theta=rows.theta[:, :, : max([0, *known]) + 1])
    channels = parts.channels.get(loop, ())
    if len(channels) != rows.power.shape[1]:
        channels = tuple(f"x[{i}]" for i in range(rows.power.shape[1]))
    health = [message for (node, _), message in parts.health.items()
              if node.rpartition("/")[0] == loop]  # fmt: skip
    guard, models = parts.guard_of(loop), parts.models[loop]
    damaged = list(parts.damaged.values())
    return History(loop, channels, rows, runs, guard, sorted(health), models, damaged)
