"""A recording in arrays, with what theta was at every state: for what needs to look at it whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.columns import LOG_TIME, iter_columns
from koop_bag.bag.reader import BagReader
from koop_lab.identify.samples import STAMP, StateSpec, batches
from koop_lab.identify.segments import Segmentation, Segmenter

THETA = "/theta:theta"


@dataclass(frozen=True)
class Loaded:
    """States one dt apart.

    Attributes
    ----------
    x : ndarray, shape (n, M)
        Measured channels.
    begins : ndarray of bool, shape (M,)
        Whether a state follows on none.
    held_out : ndarray of bool, shape (M,)
        Whether training leaves it out.
    theta : ndarray, shape (M,), or None
        Control input that was last given before each state, NaN before the first; None if the
        recording holds none.
    """

    x: NDArray[np.float64]
    begins: NDArray[np.bool_]
    held_out: NDArray[np.bool_]
    theta: NDArray[np.float64] | None

    @classmethod
    def joined(cls, parts: Sequence[Loaded]) -> Loaded:
        """Return several recordings as one; theta only if each has it."""
        thetas = [part.theta for part in parts if part.theta is not None]
        return cls(
            np.hstack([part.x for part in parts]),
            np.concatenate([part.begins for part in parts]),
            np.concatenate([part.held_out for part in parts]),
            np.concatenate(thetas) if len(thetas) == len(parts) else None,
        )


def load_states(
    bag: BagReader, state: StateSpec, segmentation: Segmentation, theta: StateSpec | None
) -> Loaded:
    """Read a recording.

    Parameters
    ----------
    bag : BagReader
        The recording.
    state : StateSpec
        Measured channels.
    segmentation : Segmentation
        How messages become states one dt apart.
    theta : StateSpec or None
        Control input, one number; None if there is none.

    Raises
    ------
    koop_bag.errors.BagError
        If the bag lacks a topic or a field.
    ValueError
        If ``theta`` is more than one number, or no state is left.
    """
    segmenter = Segmenter(segmentation, bag.topic(state.topic).count)
    period = segmentation.dt * 1e9
    states, times, begins, held_out = [], [], [], []
    for batch in segmentation.timed(batches(bag, state)):
        for segment in segmenter.split(batch):
            size = segment.states.shape[1]
            states.append(segment.states)
            times.append(segment.time + np.round(np.arange(size) * period).astype(np.int64))
            begins.append(np.arange(size) < segment.begins)
            held_out.append(np.full(size, segment.held_out))
    if not states:
        raise ValueError(f"no usable samples of {state}")
    time = np.concatenate(times)
    return Loaded(
        np.hstack(states),
        np.concatenate(begins),
        np.concatenate(held_out),
        None if theta is None else _theta_at(bag, state, theta, time),
    )


def theta_of(bag: BagReader, given: str | None) -> StateSpec | None:
    """Return which field is theta: the given one, or the loop's own where the bag has it."""
    if given is not None:
        return StateSpec.parse(given)
    own = StateSpec.parse(THETA)
    return own if any(topic.name == own.topic for topic in bag.topics) else None


def _theta_at(
    bag: BagReader, state: StateSpec, theta: StateSpec, time: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return theta at the times of states [ns]: the last one before, NaN where there is none."""
    samples = list(batches(bag, theta))
    if not samples:
        return np.full(time.size, np.nan)
    if samples[0].x.shape[1] != 1:
        raise ValueError(f"theta {theta}: {samples[0].x.shape[1]} numbers; name one of them")
    when = np.concatenate([batch.time for batch in samples])
    value = np.concatenate([batch.x[:, 0] for batch in samples])
    first = next(batches(bag, state))
    if first.stamped and not samples[0].stamped:  # by the clock of the recorder, then
        columns = next(iter_columns(bag, state.topic, [STAMP, LOG_TIME]))
        late = columns[LOG_TIME].astype(np.int64) - columns[STAMP].astype(np.int64)
        time = time + int(np.median(late))
    elif samples[0].stamped and not first.stamped:
        when = np.concatenate([batch.time for batch in batches(bag, theta, by_stamp=False)])
    order = np.argsort(when, kind="stable")
    position = np.searchsorted(when[order], time, side="right") - 1
    return np.where(position >= 0, value[order][np.maximum(position, 0)], np.nan)
