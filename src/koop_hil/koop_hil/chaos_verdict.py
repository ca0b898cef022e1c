"""Judges a run of ``koop hil chaos`` by its files; shares no code with the loop.

Read are the rig's log, the events and the recordings, these with the library of MCAP.
"""

from __future__ import annotations

import json
import struct
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.exceptions import McapError
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from numpy.typing import NDArray

LOW, HIGH, SAFE, RATE = -3.0, 4.0, 2.0, 4.0  # of theta, as the rig's sheet says
STATE = "/rig/state"
ALLOWED = 0.05  # [s] by which a command may be late, and so more than the rate's in one step
FRESH = 0.25  # [s] without a command, beyond which nobody commands
STATED = 12.0  # [s]: a stopped guard is killed after 8 s, theta returns in 1.75 s; a busy machine
BOUND = 0.2  # [s] that a recorder which was killed may lack
TIMEOUT = 20.0  # [s] without a command, after which the rig itself returns theta
KILLED = "kill recorder"
SILENT = ("sensor dead", "sensor cut")
HARMFUL = (*SILENT, "sensor nan", "sensor spiking", "sensor stuck")
LOSING = (*SILENT, "sensor lossy", "sensor delayed", "rig", "recorder", "disk", "network")


@dataclass
class ChaosVerdict:
    """Figures and failures of a run."""

    faults: Counter[str] = field(default_factory=Counter)
    """Number of faults by kind."""
    tripped: Counter[str] = field(default_factory=Counter)
    ended: Counter[str] = field(default_factory=Counter)
    """How often the guard tripped, and the loop ended, by the kind of the fault before it."""
    causes: Counter[str] = field(default_factory=Counter)
    """How often the guard tripped, by the cause that it gave."""
    own: int = 0
    """How often the rig's own time-out returned theta."""
    worst: dict[str, float] = field(default_factory=dict)
    """By kind, the longest time [s] in which theta was neither safe nor commanded as it should."""
    seconds: float = 0.0
    commanded: float = 0.0
    """Length of the run, and the share of it in which the rig heard commands."""
    memory: dict[str, tuple[int, int]] = field(default_factory=dict)
    """By process, the largest resident memory [kB] of the first and of the last third."""
    failures: list[str] = field(default_factory=list)
    """What must not be, in words; empty: passed."""

    def table(self) -> list[tuple[str, ...]]:
        """Return kinds and outcomes: a head, and a row for each kind of fault."""
        rows: list[tuple[str, ...]] = [
            ("fault", "times", "guard tripped", "loop ended", "longest unguarded [s]")
        ]
        for kind, count in sorted(self.faults.items()):
            acts = (str(number[kind]) for number in (self.tripped, self.ended))
            rows.append((kind, str(count), *acts, f"{self.worst[kind]:.1f}"))
        return rows


def judge(folder: Path) -> ChaosVerdict:
    """Judge the run of a folder."""
    events = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
    log = np.loadtxt(folder / "rig.csv", delimiter=",", ndmin=2)
    verdict = ChaosVerdict(
        seconds=float(log[-1, 0] - log[0, 0]), commanded=float((log[:, 4] < FRESH).mean())
    )
    spans = _spans(events)
    for kind, _, _ in spans:
        verdict.faults[kind] += 1
    for event in events:
        if event["what"] in ("loop ended", "tripped"):
            ended = event["what"] == "loop ended"
            counts = verdict.ended if ended else verdict.tripped
            counts[_blamed(spans, event["time"], ended)] += 1
    verdict.causes.update(event["cause"] for event in events if event["what"] == "tripped")
    verdict.own = int((np.diff((log[:, 4] > TIMEOUT).astype(int)) > 0).sum())
    verdict.failures += _wire(log, spans)
    verdict.failures += _unguarded(log, spans, verdict.worst)
    for number, begin, end in _loops(events):
        killed = [t for kind, t, _ in spans if kind == KILLED and begin <= t <= end]
        bag = folder / f"loop-{number}" / "bag"
        verdict.failures += _recording(bag, log, spans, killed[0] if killed else None)
    verdict.memory = _memory(events)
    verdict.failures += [
        f"{name} takes {last} kB at last, {first} kB at first"
        for name, (first, last) in verdict.memory.items()
        if last > 1.2 * first
    ]
    last = events[-1]
    verdict.failures += [f"left behind: {words}" for words in last["left"]]
    if not any(event["what"] == "settled" and event["follows"] for event in events):
        verdict.failures.append("the loop did not run again after the last fault")
    return verdict


def _spans(events: list[dict[str, Any]]) -> list[tuple[str, float, float]]:
    """Return kind, begin and end of every fault."""
    begun: dict[str, list[float]] = {}
    spans = []
    for event in events:
        if event["what"] == "fault" and event["on"]:
            begun.setdefault(event["kind"], []).append(event["time"])
        elif event["what"] == "fault":
            spans.append((event["kind"], begun[event["kind"]].pop(0), event["time"]))
    return spans


def _blamed(spans: list[tuple[str, float, float]], time: float, ended: bool) -> str:
    """Return the kind of the last fault before a time; one that kills, if a loop ended.

    Empty if none began within the time in which a fault has to show.
    """
    begun = [
        (ended and kind.startswith("kill"), a, kind)
        for kind, a, _ in spans
        if 0 <= time - a < STATED
    ]
    return max(begun, default=(False, 0.0, ""))[2]


def _loops(events: list[dict[str, Any]]) -> list[tuple[int, float, float]]:
    """Return number, begin and end of every loop."""
    loops = []
    for event in events:
        if event["what"] == "loop started":
            started = event
        elif event["what"] == "loop ended":
            loops.append((started["number"], started["time"], event["time"]))
    return loops


def _within(
    times: NDArray[np.float64],
    spans: list[tuple[str, float, float]],
    words: tuple[str, ...],
    margin: float,
) -> NDArray[np.bool_]:
    """Return which times lie in a fault whose kind contains one of the words, or soon after."""
    inside = np.zeros(times.size, bool)
    for kind, begin, end in spans:
        if any(word in kind for word in words):
            inside |= (times >= begin - 0.1) & (times <= end + margin)
    return inside


def _wire(log: NDArray[np.float64], spans: list[tuple[str, float, float]]) -> list[str]:
    """Return where a command broke limits or rate, unless another commands, too."""
    heard = log[~np.isnan(log[:, 3])]
    time, theta = heard[:, 0], heard[:, 3]
    failures = []
    if theta.min() < LOW or theta.max() > HIGH:
        failures.append(f"commands from {theta.min():g} to {theta.max():g}")
    step, pause = np.abs(np.diff(theta)), np.diff(time)
    fast = step > RATE * (pause + ALLOWED) * (1.0 + 1e-9)
    fast &= ~_within(time[1:], spans, ("second commander",), 1.0)
    failures += [
        f"at {time[i + 1]:.3f}: theta {theta[i]:g} to {theta[i + 1]:g} in {pause[i]:.3f} s"
        for i in np.flatnonzero(fast)
    ]
    return failures


def _unguarded(
    log: NDArray[np.float64], spans: list[tuple[str, float, float]], worst: dict[str, float]
) -> list[str]:
    """Return where theta was neither safe nor commanded for longer than stated; fill in worst.

    While a sensor says what no guard may believe, only theta_safe will do.
    """
    time = log[:, 0]
    safe = np.abs(log[:, 2] - SAFE) < 1e-6
    commanded = (log[:, 4] < FRESH) & ~_within(time, spans, HARMFUL, 0.0)
    edges = np.flatnonzero(np.diff(np.r_[False, ~(safe | commanded), False].astype(int)))
    failures = []
    for kind in {kind for kind, *_ in spans}:
        worst[kind] = 0.0
    for first, stop in edges.reshape(-1, 2):
        begin, end = time[first], time[min(stop, time.size - 1)]
        active = [kind for kind, a, b in spans if a <= end and b >= begin - STATED]
        for kind in active:
            worst[kind] = max(worst[kind], float(end - begin))
        both = all(any(name in kind for kind in active) for name in ("guard", "twin"))
        if end - begin > (TIMEOUT + 2.0 if both else STATED):  # no program is left to do it
            failures.append(f"at {begin:.1f}: unguarded for {end - begin:.1f} s: {active}")
    return failures


def _recording(
    bag: Path,
    log: NDArray[np.float64],
    spans: list[tuple[str, float, float]],
    killed: float | None,
) -> list[str]:
    """Return what a recording lacks of the samples that the rig sent."""
    have = np.isin(log[:, 1], _stamps(bag))
    if not have.any():
        return []
    first, last = np.flatnonzero(have)[[0, -1]]
    lacking = ~have[first:last]
    lacking &= ~_within(log[first:last, 0], spans, LOSING, 2.0)
    failures = [f"{bag}: {lacking.sum()} samples missing"] if lacking.any() else []
    end = log[last, 0]
    if killed is not None and killed - end > BOUND:
        others = [span for span in spans if span[0] != KILLED]
        if not _within(np.array([end, killed]), others, LOSING, 2.0).any():
            failures.append(f"{bag}: ends {killed - end:.2f} s before its recorder was killed")
    return failures


def _stamps(bag: Path) -> NDArray[np.float64]:
    """Return the stamps [ns] of the rig's samples in a recording, also of one that was cut off.

    They are rounded as the log rounds its stamps, to a fraction of a microsecond.
    """
    stamps = []
    for file in sorted(bag.glob("*.mcap")):
        topics: dict[int, str] = {}
        with file.open("rb") as stream, suppress(McapError):
            for record in StreamReader(stream).records:
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, Message) and topics.get(record.channel_id) == STATE:
                    seconds, rest = struct.unpack_from("<iI", record.data, 4)
                    stamps.append(seconds * 10**9 + rest)
    return np.array(stamps, np.float64)


def _memory(events: list[dict[str, Any]]) -> dict[str, tuple[int, int]]:
    """Return the largest memory of each process in the first and in the last third."""
    samples = [event["memory"] for event in events if event["what"] == "fault"]
    third = max(1, len(samples) // 3)
    largest: dict[str, tuple[int, int]] = {}
    for name in {name for memory in samples for name in memory}:
        parts = [
            [m[name] for m in part if name in m] for part in (samples[:third], samples[-third:])
        ]
        if all(parts):
            largest[name] = max(parts[0]), max(parts[1])
    return largest
