"""A bag as a replay needs it: states that were heard, answers, changes by the user."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.columns import read_columns, read_tables
from koop_bag.bag.reader import BagReader
from koop_core.errors import InputError
from koop_core.stream.arrival import Arrival
from koop_identify.recording.passes import STATE_TYPE, Messages, of_knobs
from koop_identify.recording.recorded_parameters import (
    CONTROLLER,
    ParameterChange,
    decoder,
    first_values,
    recorded_changes,
    recorded_values,
)
from koopman_lifter.config import SOURCES

NO_SOURCE = 255  # none of koop_msgs/Cost
FIELDS = {
    "cost": ["step", "r", "margin", "source", "model_id", "publish_time"],
    "theta": ["step", "theta", "holding", "publish_time"],
}


@dataclass(frozen=True)
class Recording:
    """States in the order in which they were heard, one row each, M in all."""

    path: Path
    """The bag."""
    state_topic: str
    """Full name of the topic of the states."""
    message: NDArray[np.int64]
    """Shape (M,): position of the state among the messages of its topic."""
    step: NDArray[np.int64]
    """Shape (M,): step index."""
    r: NDArray[np.float64]
    theta: NDArray[np.float64]
    """Shape (M,): recorded answers; NaN where there is none; theta of n > 1 knobs of shape (M, n).
    """
    margin: NDArray[np.float64]
    """Shape (M,): recorded margin of a constraint; NaN where there is none."""
    has_r: NDArray[np.bool_]
    has_theta: NDArray[np.bool_]
    """Shape (M,): whether the answer was recorded."""
    hold: NDArray[np.bool_]
    """Shape (M,): whether theta was held although the cost was finite: by the hold service or
    inactivity."""
    source: NDArray[np.uint8]
    """Shape (M,): which cost was answered; NO_SOURCE where there is no answer."""
    model: NDArray[np.str_]
    """Shape (M,): id of the model that answered; empty where there is no answer."""
    values: dict[str, dict[str, Any]]
    """Parameters by node at the first state; empty if they were not recorded."""
    changes: tuple[ParameterChange, ...]
    """Parameters changed while recording, in order of their first state."""
    unknown: list[str]
    """Parameters that were changed while recording and of which the first value is not known."""
    repeated: int
    unanswered: int
    """States that are left out: sent again, and without a recorded cost."""

    @property
    def without_parameters(self) -> list[str]:
        """The nodes of which the bag has no parameters."""
        return [node for node in CONTROLLER if node not in self.values]

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
    def channels(self) -> int:
        """Length of the first state that is not empty."""
        with BagReader(self.path) as bag:
            return self._first_length(bag)

    def states(self, n: int = 0) -> NDArray[np.float64]:
        """Return x', shape (M, n); a row of NaN, an unusable state, where its length is not n.

        By default n is the length of the first one, as of the raw cost, which takes any.
        """
        with BagReader(self.path) as bag:
            n = n or self._first_length(bag)
            fields = [f"x[{i}]" for i in range(n + 1)]
            columns = read_columns(bag, self.state_topic, fields)
        x = np.stack([columns[name][self.message] for name in fields[:n]], axis=1)
        x[~np.isnan(columns[fields[n]][self.message])] = np.nan
        return np.ascontiguousarray(x, dtype=np.float64)

    def _first_length(self, bag: BagReader) -> int:
        """Return the length of the first state that is not empty."""
        decode, first = decoder(bag, self.state_topic), self.message[0]
        messages = islice(bag.messages([self.state_topic]), int(first), None)
        return next((n for m in messages if (n := len(decode(m.data).x))), 1)


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
    koop_core.errors.InputError
        If it holds no states of a loop that it answered.
    """
    base = namespace.rstrip("/")
    topic = f"{base}/state"
    with BagReader(path) as bag:
        types = {item.name: item.type_name for item in bag.topics if item.count}
        if types.get(topic) != STATE_TYPE:
            loops = [
                name.removesuffix("/state") or "/" for name, k in types.items() if k == STATE_TYPE
            ]
            remedy = f"--namespace {' or '.join(sorted(loops))}" if loops else "nothing to replay"
            raise InputError(f"{path}: no {STATE_TYPE} on {topic}: {remedy}")
        names = {name: fields for name, fields in FIELDS.items() if f"{base}/{name}" in types}
        tables = read_tables(
            bag, {topic: ["step"], **{f"{base}/{name}": f for name, f in names.items()}}
        )
        state = Messages(tables[topic])
        cost = Messages(tables.get(f"{base}/cost"))
        theta = Messages(tables.get(f"{base}/theta"))
        rows = state.kind != Arrival.REPEAT
        # A state without a cost was not seen by the lifter: its filters know nothing of it.
        lacking = rows & (state.kind != Arrival.LATE) & ~cost.hold(state.key)
        if cost.key.size:
            rows &= ~lacking
        message = np.flatnonzero(rows)
        if not message.size:
            raise InputError(f"{path}: none of the {state.step.size} states has a recorded cost")
        late = state.kind[message] == Arrival.LATE
        key = np.where(late, -1, state.key[message])  # no key: no answer
        values = recorded_values(bag, namespace)
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
        state.step[message],
        r,
        of_knobs(theta.at(key, "theta", np.nan)),
        np.asarray(cost.at(key, "margin", np.nan), np.float64),
        cost.hold(key),
        theta.hold(key),
        np.asarray(theta.at(key, "holding", False).astype(np.bool_) & np.isfinite(r)),
        source,
        model,
        values,
        changes,
        unknown,
        int(np.count_nonzero(state.kind == Arrival.REPEAT)),
        int(np.count_nonzero(lacking)) if cost.key.size else 0,
    )
