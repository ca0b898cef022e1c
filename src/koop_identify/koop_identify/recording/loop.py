"""What the bag of a loop says, aligned by step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.columns import Columns, read_columns, read_tables
from koop_bag.bag.losses import count_losses
from koop_bag.bag.reader import BagReader
from koop_bag.errors import BagError
from koop_core.config.fields import MAX_FIELDS, Source
from koop_core.errors import InputError
from koop_guard.guard import Cause, Status
from koop_identify.recording.loaded import theta_at
from koop_identify.recording.passes import MAX_STEP, STATE_TYPE, Messages, of_knobs
from koop_identify.recording.signals import Signals

STAMP = "header.stamp"
FIELDS = {
    "state": ["step", "x", STAMP],
    "cost": ["step", "r", "model_id"],
    "theta": ["step", "theta", "saturated"],
    "ground_truth": ["step", "x"],
}
GUARD = ["status", "cause", "reason", "tripped_at", STAMP, "log_time"]
BY_ROW = (
    "step", "t", "measured", "ground_truth", "r", "theta", "limited", "answered", "tripped",
)  # fmt: skip


class Trips(NamedTuple):
    """How often a guard tripped, and the last time: why, when, when rearmed [s since the epoch].

    NaN: it was not rearmed.
    """

    times: int
    reason: str
    when: float
    rearmed: float


@dataclass(frozen=True)
class LoopRecord(Signals):
    """Signals of a recorded loop.

    Where steps restart within the bag, as of a plant that was started again, the rows are those of
    the longest run.
    """

    answered: NDArray[np.bool_]
    """Shape (M,): whether all topics have the step."""
    model_id: str
    """Model of the first cost; empty if there is none."""
    lost: dict[str, int]
    counts: dict[str, int]
    """Missing steps and messages by topic."""
    duration: float
    """Wall-clock time from the first to the last state [s]."""
    passes: int
    """How often the steps of the states begin."""
    tripped: NDArray[np.bool_]
    """Shape (M,): whether the guard held theta, tripped."""
    trips: Trips | None
    """What tripped it; None if nothing did."""

    def closed(self, bag: Path) -> LoopRecord:
        """Return the steps that have a state, a cost and a theta.

        Raises
        ------
        koop_core.errors.InputError
            If there are none.
        """
        for name in ("cost", "theta"):
            if not self.counts.get(name):
                raise InputError(
                    f"{bag}: no messages on '{name}', this is not a recording of a closed loop"
                )
        if not self.answered.any():
            raise InputError(f"{bag}: no step has a state, a cost and a theta")
        rows = {name: getattr(self, name)[self.answered] for name in BY_ROW}
        return replace(self, **rows, begins=_begins(rows["step"]))


def read_loop(
    bag: Path,
    namespace: str = "/",
    commands: Sequence[Source] = (),
    dt: float | None = None,
    names: tuple[str, ...] = (),
) -> LoopRecord:
    """Read the loop's four topics from a bag; only the states must be there.

    With commands that the bag has, as of a guard, theta is what the rig was told when a state was
    received; the guard's way to theta_safe at the end is not the loop's. Without ``dt`` [s], it is
    the usual time between two steps as stamped, else as received.

    Raises
    ------
    koop_bag.errors.BagError
        If the bag cannot be read.
    koop_core.errors.InputError
        If it holds no states of a loop.
    """
    base = namespace.rstrip("/")
    with BagReader(bag) as reader:
        present = {topic.name: topic.type_name for topic in reader.topics if topic.count}
        if present.get(f"{base}/state") != STATE_TYPE:
            others = ", ".join(f"{name} ({kind})" for name, kind in sorted(present.items()))
            raise InputError(
                f"{bag}: no states of a loop on {base}/state. For other messages name the fields: "
                f"--measured /TOPIC:FIELD,FIELD. It has {others or 'no messages'}"
            )
        inactive = {name: reader.inactive_steps(f"{base}/{name}") for name in FIELDS}
        columns = _columns(reader, base, [name for name in FIELDS if f"{base}/{name}" in present])
        if commands and {c.topic for c in commands} <= {*present} - {f"{base}/theta"}:
            columns["state"]["commanded"] = theta_at(reader, f"{base}/state", commands)
        trips = None
        if (topic := f"{base}/koop_guard/state") in present:
            trips = _take_guard(columns["state"], read_columns(reader, topic, GUARD))
    return _align(columns, inactive, trips, dt or _measured_dt(bag, columns["state"]), names)


def _take_guard(state: Columns, guard: Columns) -> Trips | None:
    """Note at the states when the guard held theta, and forget theta from the loop's end on."""
    ended, times = guard["cause"] == Cause.ENDED.value, guard["log_time"].astype(np.int64)
    if ended.any() and "commanded" in state:
        state["commanded"][state["log_time"] > times[ended].min()] = np.nan
    tripped = (guard["status"] == Status.TRIPPED) & ~ended
    if not tripped.any():
        return None
    at = np.searchsorted(times, state["log_time"].astype(np.int64), "right") - 1
    state["tripped"] = (at >= 0) & tripped[at]
    last = int(np.flatnonzero(tripped)[-1])
    later = times[last:][guard["status"][last:] == Status.FOLLOWING]
    ago = 1e-9 * guard[STAMP][last] - guard["tripped_at"][last]
    how_often = np.unique(guard["tripped_at"][tripped].round(1)).size
    rearmed = 1e-9 * later[0] if later.size else math.nan
    return Trips(how_often, guard["reason"][last], 1e-9 * times[last] - ago, rearmed)


def _columns(bag: BagReader, base: str, names: list[str]) -> dict[str, Columns]:
    """Read topics; a state of another length than most, which has no use, is a row of NaN."""
    wanted = {f"{base}/{name}": [*FIELDS[name], "log_time"] for name in names}
    try:
        return dict(zip(names, read_tables(bag, wanted).values(), strict=True))
    except BagError:
        elements = [f"x[{i}]" for i in range(MAX_FIELDS)]  # NaN where a message has none
        wanted[f"{base}/state"] = [*(n for n in wanted[f"{base}/state"] if n != "x"), *elements]
        columns = dict(zip(names, read_tables(bag, wanted).values(), strict=True))
    state = columns["state"]
    x = np.stack([state.pop(name) for name in elements], axis=1).astype(np.float64)
    n = int(np.median((~np.isnan(x)).sum(axis=1)))
    x[~np.isnan(x[:, n:]).all(axis=1)] = np.nan
    state["x"] = x[:, :n]
    return columns


def _align(
    columns: dict[str, Columns],
    inactive: dict[str, int],
    trips: Trips | None,
    dt: float,
    names: tuple[str, ...],
) -> LoopRecord:
    """Look up the topics' values by the steps of the states.

    Steps that passed while a node was inactive, by topic, are not lost.
    """
    messages = {name: Messages(values) for name, values in columns.items()}
    every = messages["state"].heard
    answered = np.ones(every.size, np.bool_)
    for topic in messages.values():
        answered &= topic.hold(every)
    number = every // MAX_STEP
    longest = np.bincount(number[answered] if answered.any() else number).argmax()
    rows = every[number == longest]
    ends = np.flatnonzero(np.diff(number))
    first, last = np.insert(ends + 1, 0, 0), np.append(ends, every.size - 1)

    def at(name: str, field: str) -> NDArray[np.float64]:
        values = messages.get(name, Messages(None)).at(rows, field, np.nan)
        return np.asarray(values, np.float64)

    theta = of_knobs(at("theta", "theta"))
    limited = messages.get("theta", Messages(None)).at(rows, "saturated", False).astype(np.bool_)
    if "commanded" in columns["state"]:  # the controller's limit counts where the rig was at it
        answer, theta = theta, at("state", "commanded")
        limited &= np.isclose(answer, theta).reshape(rows.size, -1).all(axis=1)
    models = columns.get("cost", {}).get("model_id", ())
    times = columns["state"]["log_time"].astype(np.int64)
    step, x = rows % MAX_STEP, at("state", "x")
    n = x.shape[1]
    return LoopRecord(
        names if len(names) == n else tuple(f"x[{i}]" for i in range(n)),
        dt,
        "steps",
        step,
        np.asarray(step * dt, np.float64),
        _begins(step),
        x,
        at("ground_truth", "x") if "ground_truth" in columns else np.empty((rows.size, 0)),
        at("cost", "r"),
        theta,
        limited if "theta" in columns else None,
        int((every[last] - every[first] + 1).sum()) * dt,
        answered[number == longest],
        str(next((name for name in models if name), "")),
        {
            name: max(0, count_losses(topic.step).lost - inactive[name])
            for name, topic in messages.items()
        },
        {name: topic.step.size for name, topic in messages.items()},
        float((times[-1] - times[0]) * 1e-9),
        int(number[-1]),
        messages["state"].at(rows, "tripped", False).astype(np.bool_),
        trips,
    )


def _begins(step: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which states follow on none."""
    return np.diff(step, prepend=step[0] - 2) != 1


def _measured_dt(bag: Path, state: Columns) -> float:
    """Return the usual time between two steps as stamped, else as received [s]."""
    stamped = (state[STAMP] > 0).sum() > 1
    times = state[STAMP if stamped else "log_time"].astype(np.int64)
    apart = np.diff(state["step"].astype(np.int64))
    if not (apart > 0).any():
        raise InputError(f"{bag}: no state follows on another, which would tell dt: give --dt")
    return float(np.median(np.diff(times)[apart > 0] / apart[apart > 0])) * 1e-9
