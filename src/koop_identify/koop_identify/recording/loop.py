"""A recorded run as arrays: what the bag of one loop says, aligned by step."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.columns import Columns, read_columns
from koop_bag.bag.extent import measure
from koop_bag.bag.losses import count_losses
from koop_bag.bag.reader import BagReader
from koop_bag.errors import BagError
from koop_core.errors import InputError
from koop_identify.recording.passes import MAX_STEP, STATE_TYPE, keys

STAMP = "header.stamp"
FIELDS = {
    "state": ["step", "x", STAMP],
    "cost": ["step", "r", "model_id"],
    "theta": ["step", "theta", "saturated"],
    "ground_truth": ["step", "x"],
}
SWING = "float64 swing"  # of a ControlInput; older bags lack it


@dataclass(frozen=True)
class RecordedRun:
    """Signals of a recorded loop, one row a step that all topics have.

    Where steps restart within the bag, as of a plant that was started again, the signals are
    those of the longest pass.

    Attributes
    ----------
    step : ndarray of int64, shape (M,)
        Step index.
    measured, ground_truth : ndarray, shape (M, n)
        x' and, if it was recorded, x; else of shape (M, 0).
    r, theta : ndarray, shape (M,)
        Cost and control input.
    lost : dict
        Missing steps by topic.
    counts : dict
        Messages by topic.
    duration : float
        Wall-clock time from the first to the last state [s].
    state_time : ndarray, shape (K,)
        Receive time of every state [s], from the first.
    passes : int
        How often the steps of the states begin.
    """

    step: NDArray[np.int64]
    measured: NDArray[np.float64]
    ground_truth: NDArray[np.float64]
    r: NDArray[np.float64]
    theta: NDArray[np.float64]
    lost: dict[str, int]
    counts: dict[str, int]
    duration: float
    state_time: NDArray[np.float64]
    passes: int

    def t(self, dt: float) -> NDArray[np.float64]:
        """Return t_k = k dt [s], shape (M,)."""
        return np.asarray(self.step * dt, dtype=np.float64)


def _columns(bag: BagReader, topic: str, wanted: list[str]) -> Columns:
    """Read a topic; a state of another length than most, which has no use, is a row of NaN."""
    try:
        return read_columns(bag, topic, wanted)
    except BagError:
        if "x" not in wanted:
            raise
    elements = [name for name in measure(bag, topic).fields if name.startswith("x[")]
    columns = read_columns(bag, topic, [*(name for name in wanted if name != "x"), *elements])
    x = np.stack([columns.pop(name) for name in elements], axis=1).astype(np.float64)
    n = int(np.median((~np.isnan(x)).sum(axis=1)))
    x[~np.isnan(x[:, n:]).all(axis=1)] = np.nan
    return {**columns, "x": x[:, :n]}


class LoopColumns:
    """What the bag of a loop holds, looked up by the steps of its states.

    Where steps restart within the bag, the rows are those of the longest run.

    Parameters
    ----------
    columns : dict
        By topic; `state` is among them and not empty.

    Attributes
    ----------
    step : ndarray of int64, shape (M,)
        Of the states, increasing.
    answered : ndarray of bool, shape (M,)
        Whether all topics have the step.
    lost, counts : dict
        Missing steps and messages by topic.
    state_time : ndarray, shape (K,)
        Receive time of every state [s], from the first.
    passes : int
        How often the steps of the states begin.
    recorded_steps : int
        Steps from the first to the last state, of all runs together.
    """

    def __init__(self, columns: dict[str, dict[str, Any]]) -> None:
        self._columns = columns
        steps = {name: column["step"].astype(np.int64) for name, column in columns.items()}
        self._keys = {name: keys(values)[1] for name, values in steps.items()}
        every = np.unique(self._keys["state"])
        answered = np.ones(every.size, np.bool_)
        for known in self._keys.values():
            answered &= np.isin(every, known)
        number = every // MAX_STEP
        longest = np.bincount(number[answered] if answered.any() else number).argmax()
        chosen = number == longest
        self._rows, self.answered = every[chosen], answered[chosen]
        self.step = self._rows % MAX_STEP
        self.passes = int(number[-1])
        ends = np.flatnonzero(np.diff(number))
        first, last = np.insert(ends + 1, 0, 0), np.append(ends, every.size - 1)
        self.recorded_steps = int((every[last] - every[first] + 1).sum())
        self.lost = {name: count_losses(values).lost for name, values in steps.items()}
        self.counts = {name: values.size for name, values in steps.items()}
        stamps = columns["state"]["log_time"].astype(np.int64)
        self.state_time = (stamps - stamps[0]) * 1e-9

    def has(self, name: str) -> bool:
        """Return whether there are messages on a topic."""
        return bool(self.counts.get(name))

    def at(self, name: str, field: str) -> NDArray[np.float64]:
        """Return a field, one row a state; NaN where the topic lacks step or field.

        The first message of a step counts: a repeated one is the same answer again.
        """
        if not self.has(name) or field not in self._columns[name]:
            return np.full(self._rows.size, np.nan)
        values = self._columns[name][field].astype(np.float64)
        unique, first = np.unique(self._keys[name], return_index=True)
        place = np.minimum(np.searchsorted(unique, self._rows), unique.size - 1)
        found: NDArray[np.float64] = values[first[place]]
        found[unique[place] != self._rows] = np.nan
        return found

    @property
    def first_model(self) -> str:
        """Id of the model of the first cost; empty if there is none."""
        if not self.has("cost"):
            return ""
        return str(next((name for name in self._columns["cost"]["model_id"] if name), ""))

    @property
    def measured_dt(self) -> float:
        """The usual time between two steps as stamped, else as received [s]."""
        state = self._columns["state"]
        stamped = (state[STAMP] > 0).sum() > 1
        times = state[STAMP if stamped else "log_time"].astype(np.int64)
        apart = np.diff(state["step"].astype(np.int64))
        return float(np.median(np.diff(times)[apart > 0] / apart[apart > 0])) * 1e-9


def read_loop(bag: Path, namespace: str = "/") -> LoopColumns:
    """Read the loop's four topics from a bag; only the states must be there.

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
        columns: dict[str, dict[str, Any]] = {}
        for name, wanted in FIELDS.items():
            topic = f"{base}/{name}"
            if topic in present:
                if name == "theta" and SWING in reader.topic(topic).definition:
                    wanted = [*wanted, "swing"]
                columns[name] = _columns(reader, topic, [*wanted, "log_time"])
    return LoopColumns(columns)


def read_run(bag: Path, namespace: str = "/") -> RecordedRun:
    """Read a closed loop from a bag.

    Raises
    ------
    koop_bag.errors.BagError
        If the bag cannot be read.
    koop_core.errors.InputError
        If it does not hold a closed loop.
    """
    return closed_loop(read_loop(bag, namespace), bag)


def closed_loop(columns: LoopColumns, bag: Path) -> RecordedRun:
    """Return the steps that have a state, a cost and a theta.

    Raises
    ------
    koop_core.errors.InputError
        If there are none.
    """
    for name in ("cost", "theta"):
        if not columns.has(name):
            raise InputError(
                f"{bag}: no messages on '{name}', this is not a recording of a closed loop"
            )
    rows = columns.answered
    if not rows.any():
        raise InputError(f"{bag}: no step has a state, a cost and a theta")
    truth = columns.at("ground_truth", "x")[rows] if columns.has("ground_truth") else None
    return RecordedRun(
        columns.step[rows],
        columns.at("state", "x")[rows],
        np.empty((int(rows.sum()), 0)) if truth is None else truth,
        columns.at("cost", "r")[rows],
        columns.at("theta", "theta")[rows],
        columns.lost,
        columns.counts,
        float(columns.state_time[-1]),
        columns.state_time,
        columns.passes,
    )
