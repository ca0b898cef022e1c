"""The messages of a recorded topic as a node hears them, known by pass and step.

Steps may restart within a bag. A message is therefore known by its pass (how many runs began
before it, as the nodes' StreamMonitor sees it) and its step.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.columns import Columns
from koop_core.errors import InputError
from koop_core.stream.arrival import NOTHING, Arrival
from koop_loop.kernel import listen

STATE_TYPE = "koop_msgs/msg/MeasuredState"
MAX_STEP = 2**40  # 170 years at 200 Hz; leaves room for the number of the pass in 64 bits


class Messages:
    """The messages of a topic, from their fields, ``step`` among them; None if there is none.

    Of each, shape (K,), ``kind`` is what the nodes' StreamMonitor says about its ``step``, ``key``
    pass and step in one number; ``heard`` are the keys of those that are neither repeated nor late,
    in order.
    """

    def __init__(self, columns: Columns | None) -> None:
        self._columns = columns or {"step": np.empty(0, np.int64)}
        self.step = self._columns["step"].astype(np.int64)
        self.kind, self.key = keys(self.step)
        rows = np.flatnonzero((self.kind != Arrival.REPEAT) & (self.kind != Arrival.LATE))
        self._rows = rows[np.argsort(self.key[rows], kind="stable")]
        self.heard = self.key[self._rows]

    def hold(self, key: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which keys are there."""
        return np.isin(key, self.heard)

    def at(self, key: NDArray[np.int64], name: str, absent: Any) -> NDArray[Any]:
        """Return a field of the messages with these keys, `absent` where there is none."""
        if not self.heard.size or name not in self._columns:
            return np.full(key.size, absent)
        place = np.minimum(np.searchsorted(self.heard, key), self.heard.size - 1)
        values = self._columns[name][self._rows[place]]
        values[self.heard[place] != key] = absent
        return values


def of_knobs(values: NDArray[Any]) -> NDArray[np.float64]:
    """Return theta of messages, shape (K, n), as arrays have it: of one knob in shape (K,)."""
    values = np.asarray(values, np.float64)
    return values[:, 0] if values.ndim > 1 and values.shape[1] == 1 else values


def each_knob(name: str, values: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Return the values of each knob by a name: of one in shape (K,), else of shape (K, n)."""
    if values.ndim == 1:
        return {name: values}
    return {f"{name}[{i}]": np.ascontiguousarray(values[:, i]) for i in range(values.shape[1])}


def keys(step: NDArray[np.int64]) -> tuple[NDArray[np.int8], NDArray[np.int64]]:
    """Return what a StreamMonitor says about each message, and pass and step in one number.

    Raises
    ------
    koop_core.errors.InputError
        If a step is none.
    """
    if step.size and not 0 <= step.min() <= step.max() < MAX_STEP:
        raise InputError("a step is not a count: the recording is damaged")
    kinds = np.full(step.size, Arrival.NEXT, np.int8)
    if (step[1:] > step[:-1]).all():  # most recordings: no kernel, and no numba
        kinds[:1] = np.where(step[:1] == 0, Arrival.RESTART, Arrival.JOIN)
    else:
        listen(step, 0.0, NOTHING, kinds)
    begins = (kinds == Arrival.RESTART) | (kinds == Arrival.JOIN)
    return kinds, np.cumsum(begins) * MAX_STEP + step
