"""What a replay needs of a bag: the states that were answered, the answers, what the user changed.

The nodes answer a repeated step with the same answer and a step that went back as a new beginning.
A message is therefore known by its pass (how often the steps went back before it) and its step.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_bag.columns import Columns, read_columns, read_tables
from koop_bag.reader import BagReader
from koop_lab.replay.settings import Change, first_values, recorded_changes, recorded_values
from koopman_lifter.config import SOURCES

STATE_TYPE = "koop_msgs/msg/MeasuredState"
NO_SOURCE = 255  # none of koop_msgs/Cost
MAX_STEP = 2**40  # 170 years at 200 Hz; leaves room for the number of the pass in 64 bits
FIELDS = {
    "cost": ["step", "r", "source", "model_id", "publish_time"],
    "theta": ["step", "theta", "holding", "publish_time"],
}


@dataclass(frozen=True)
class Recording:
    """States in the order in which they were answered, one row each, M in all.

    Attributes
    ----------
    path : Path
        The bag.
    state_topic : str
        Full name of the topic of the states.
    message : ndarray of int64, shape (M,)
        Position of the state among the messages of its topic.
    step : ndarray of int64, shape (M,)
        Step index; grows but for the beginning of another pass.
    r, theta : ndarray, shape (M,)
        Recorded answers; NaN where there is none.
    has_r, has_theta : ndarray of bool, shape (M,)
        Whether the answer was recorded.
    hold : ndarray of bool, shape (M,)
        Whether theta was held although the cost was finite: by the hold service or inactivity.
    source : ndarray of int, shape (M,)
        Which cost was answered; NO_SOURCE where there is no answer.
    model : ndarray of str, shape (M,)
        Id of the model that answered; empty where there is no answer.
    values : dict
        Parameters by node at the first state; empty if they were not recorded.
    changes : tuple of Change
        Parameters changed while recording, in order of their first state.
    unknown : list of str
        Parameters that were changed while recording and of which the first value is not known.
    repeated, unanswered : int
        States that are no part of this: of a step asked again, and without a recorded cost.
    """

    path: Path
    state_topic: str
    message: NDArray[np.int64]
    step: NDArray[np.int64]
    r: NDArray[np.float64]
    theta: NDArray[np.float64]
    has_r: NDArray[np.bool_]
    has_theta: NDArray[np.bool_]
    hold: NDArray[np.bool_]
    source: NDArray[np.uint8]
    model: NDArray[np.str_]
    values: dict[str, dict[str, Any]]
    changes: tuple[Change, ...]
    unknown: list[str]
    repeated: int
    unanswered: int

    @property
    def first_model(self) -> str:
        """Id of the model of the first answer; empty if there is none."""
        return str(next((name for name in self.model if name), ""))

    @property
    def first_cost(self) -> str:
        """Kind of the first answer, a value of the parameter `cost`; empty if there is none."""
        names = {number: name for name, number in SOURCES.items()}
        return next((names[int(number)] for number in self.source if int(number) in names), "")

    @property
    def in_progress(self) -> bool:
        """Whether the recording began in mid-run: the detector's first answer is always 0."""
        first = np.flatnonzero(self.has_r & np.isfinite(self.r))
        return bool(first.size) and float(self.r[first[0]]) != 0.0

    def states(self, n: int) -> NDArray[np.float64]:
        """Return x', shape (M, n); a row of NaN, an unusable state, where its length is not n."""
        fields = [f"x[{i}]" for i in range(n + 1)]
        with BagReader(self.path) as bag:
            columns = read_columns(bag, self.state_topic, fields)
        x = np.stack([columns[name][self.message] for name in fields[:n]], axis=1)
        x[~np.isnan(columns[fields[n]][self.message])] = np.nan
        return np.ascontiguousarray(x, dtype=np.float64)


def read_recording(path: Path, namespace: str = "/") -> Recording:
    """Read all of a bag but the states themselves.

    Parameters
    ----------
    path : Path
        Folder of a run or of a bag, or an `.mcap` file.
    namespace : str
        Namespace of the loop.

    Raises
    ------
    koop_bag.errors.BagError
        If the bag cannot be read.
    ValueError
        If it holds no states of a loop.
    """
    base = namespace.rstrip("/")
    topic = f"{base}/state"
    with BagReader(path) as bag:
        types = {item.name: item.type_name for item in bag.topics if item.count}
        if types.get(topic) != STATE_TYPE:
            raise ValueError(f"{path}: no {STATE_TYPE} on {topic}, there is nothing to replay")
        wanted = {name: fields for name, fields in FIELDS.items() if f"{base}/{name}" in types}
        tables = read_tables(
            bag, {topic: ["step"], **{f"{base}/{name}": f for name, f in wanted.items()}}
        )
        cost = _Answers(tables.get(f"{base}/cost"))
        theta = _Answers(tables.get(f"{base}/theta"))
        steps = tables[topic]["step"]
        key, message = _first_of_each(steps)
        # A state without a cost was not seen by the lifter: its filters know nothing of it.
        fed = cost.holds(key) if cost.key.size else np.ones(key.size, np.bool_)
        unanswered = int(key.size - fed.sum())
        key, message = key[fed], message[fed]
        values = recorded_values(bag, path, namespace)
        r, model = cost.at(key, "r", np.nan), cost.at(key, "model_id", "").astype(np.str_)
        source = cost.at(key, "source", NO_SOURCE)
        changes = recorded_changes(
            bag,
            namespace,
            {
                "koopman_lifter": cost.at(key, "publish_time", 0),
                "relay_esc": theta.at(key, "publish_time", 0),
            },
            source,
            model,
        )
        values, unknown = first_values(bag, namespace, values, changes)
    return Recording(
        Path(path),
        topic,
        message,
        steps[message].astype(np.int64),
        r,
        theta.at(key, "theta", np.nan),
        cost.holds(key),
        theta.holds(key),
        np.asarray(theta.at(key, "holding", False).astype(np.bool_) & np.isfinite(r)),
        source,
        model,
        values,
        changes,
        unknown,
        steps.size - key.size - unanswered,
        unanswered,
    )


class _Answers:
    """The messages of a topic by key; the first one of a key counts, the others repeat it."""

    def __init__(self, columns: Columns | None) -> None:
        self._columns = columns or {}
        self.key, self._message = _first_of_each(self._columns.get("step", np.empty(0, np.uint64)))

    def holds(self, key: NDArray[np.int64]) -> NDArray[np.bool_]:
        return np.isin(key, self.key)

    def at(self, key: NDArray[np.int64], name: str, absent: Any) -> NDArray[Any]:
        """Return a field of the answers to `key`, `absent` where there is none."""
        if not self.key.size:
            return np.full(key.size, absent)
        place = np.minimum(np.searchsorted(self.key, key), self.key.size - 1)
        found = self._columns[name][self._message[place]]
        return np.where(self.key[place] == key, found, absent)


def _first_of_each(steps: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the keys, growing, and where the first message of each lies."""
    if steps.size and steps.max() >= MAX_STEP:
        raise ValueError(f"step {steps.max()} is no count of steps: the recording is damaged")
    signed = steps.astype(np.int64)
    passes = np.concatenate(([0], np.cumsum(np.diff(signed) < 0))) if signed.size else signed
    key, message = np.unique(passes * MAX_STEP + signed, return_index=True)
    return key, message.astype(np.int64)
