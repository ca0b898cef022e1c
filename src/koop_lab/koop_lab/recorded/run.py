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
from koop_lab.replay.recording import MAX_STEP, keys

FIELDS = {
    "state": ["step", "x"],
    "cost": ["step", "r"],
    "theta": ["step", "theta"],
    "ground_truth": ["step", "x"],
}


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


def read_run(bag: Path, namespace: str = "/") -> RecordedRun:
    """Read the loop's four topics from a bag.

    Raises
    ------
    koop_bag.errors.BagError
        If the bag cannot be read.
    ValueError
        If it does not hold a closed loop.
    """
    with BagReader(bag) as reader:
        present = {topic.name for topic in reader.topics}
        columns: dict[str, dict[str, Any]] = {}
        for name, wanted in FIELDS.items():
            topic = f"{namespace.rstrip('/')}/{name}"
            if topic in present:
                columns[name] = _columns(reader, topic, [*wanted, "log_time"])
    for name in ("state", "cost", "theta"):
        if name not in columns or columns[name]["step"].size == 0:
            raise ValueError(
                f"{bag}: no messages on '{name}', this is not a recording of a closed loop"
            )
    steps = {name: column["step"].astype(np.int64) for name, column in columns.items()}
    known = {name: keys(values)[1] for name, values in steps.items()}
    common = np.unique(known["state"])
    passes = int(common[-1] // MAX_STEP)
    for values in known.values():
        common = np.intersect1d(common, values)
    if not common.size:
        raise ValueError(f"{bag}: no step has a state, a cost and a theta")
    common = common[common // MAX_STEP == np.bincount(common // MAX_STEP).argmax()]

    def at(name: str, field: str) -> NDArray[np.float64]:
        # the first message of a step counts: a repeated one is the same answer again
        unique, first = np.unique(known[name], return_index=True)
        chosen: NDArray[np.float64] = columns[name][field][first[np.searchsorted(unique, common)]]
        return chosen

    stamps = columns["state"]["log_time"].astype(np.int64)
    seconds = (stamps - stamps[0]) * 1e-9
    return RecordedRun(
        common % MAX_STEP,
        at("state", "x"),
        at("ground_truth", "x") if "ground_truth" in columns else np.empty((common.size, 0)),
        at("cost", "r"),
        at("theta", "theta"),
        {name: count_losses(values).lost for name, values in steps.items()},
        {name: values.size for name, values in steps.items()},
        float(seconds[-1]),
        seconds,
        passes,
    )
