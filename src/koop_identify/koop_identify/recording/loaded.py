"""A recording in arrays, with what theta was at every state: for what needs to look at it whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.columns import LOG_TIME, Columns, read_tables
from koop_bag.bag.reader import BagReader
from koop_core.config.fields import Source, parse_source
from koop_core.errors import InputError
from koop_identify.recording.passes import of_knobs
from koop_identify.recording.samples import batches, stack_numbers
from koop_identify.recording.segmentation import BagReading
from koop_identify.recording.segments import Segmentation, Segmenter
from koop_identify.settings import READING

LOOP_COMMAND = parse_source("/theta:theta[0]")
ROUNDED = 1e-6  # more than an interpolated number of a sample is off by rounding


@dataclass(frozen=True)
class Loaded:
    """States one dt apart."""

    x: NDArray[np.float64]
    """Shape (n, M): measured channels."""
    begins: NDArray[np.bool_]
    """Shape (M,): whether a state follows on none."""
    theta: NDArray[np.float64] | None
    """Shape (M,) or of n > 1 knobs (M, n): control input that was last received before each state,
    NaN before the first and where one that usually comes often has stayed away; None if the
    recording holds none."""
    time: NDArray[np.float64]
    """Shape (M,): from the first state [s]; of several recordings, each from its own."""
    recorded: float = 0.0
    """Time from the first to the last sample, usable or not [s]; of all recordings."""

    def after(self, first: int) -> Loaded:
        """Return the recording from a sample on."""
        theta = None if self.theta is None else self.theta[first:]
        begins = self.begins[first:].copy()
        begins[:1] = True
        return replace(
            self,
            x=self.x[:, first:],
            begins=begins,
            theta=theta,
            time=self.time[first:],
        )

    @classmethod
    def joined(cls, parts: Sequence[Loaded]) -> Loaded:
        """Return several recordings as one; theta only if each has it."""
        thetas = [part.theta for part in parts if part.theta is not None]
        return cls(
            np.hstack([part.x for part in parts]),
            np.concatenate([part.begins for part in parts]),
            np.concatenate(thetas) if len(thetas) == len(parts) else None,
            np.concatenate([part.time for part in parts]),
            sum(part.recorded for part in parts),
        )


def list_segments(begins: NDArray[np.bool_]) -> list[slice]:
    """Return the segments that samples fall into, of which each begins where ``begins`` is set."""
    bounds = np.append(np.flatnonzero(begins), begins.size)
    return [slice(begin, end) for begin, end in pairwise(bounds.tolist())]


def load_recording(bag: BagReader, reading: BagReading, segmentation: Segmentation) -> Loaded:
    """Read a recording with the command of the reading, or the loop's own where the bag has it.

    Raises
    ------
    koop_bag.errors.BagError
        If the bag lacks a topic or a field.
    koop_core.errors.InputError
        If no state is left.
    """
    measured, commands = reading.measured, reading.commands
    if not commands and any(topic.name == LOOP_COMMAND.topic for topic in bag.topics):
        commands = (LOOP_COMMAND,)
    segmenter = Segmenter(segmentation)
    theta = theta_at(bag, measured.topic, commands) if commands else None
    parts, begins, n, last = [], [], 0, 0.0
    origin: int | None = None
    for batch in segmentation.timed(batches(bag, measured)):
        origin, n = int(batch.time[0]) if origin is None else origin, batch.x.shape[1]
        # time and number of a sample go the way of its state
        time = (batch.time - origin) * 1e-9
        number, last = segmenter.samples + np.arange(time.size), float(time[-1])
        for segment in segmenter.split(replace(batch, x=np.column_stack((batch.x, time, number)))):
            size = segment.states.shape[1]
            parts.append(segment.states)
            begins.append(np.arange(size) < segment.begins)
    if not parts:
        raise InputError(f"no usable samples of {measured}")
    rows_of = np.hstack(parts)
    return Loaded(
        np.ascontiguousarray(rows_of[:n]),
        np.concatenate(begins),
        None if theta is None else theta[np.floor(rows_of[n + 1] + ROUNDED).astype(np.int64)],
        rows_of[n],
        last,
    )


def theta_at(bag: BagReader, measured: str, commands: Sequence[Source]) -> NDArray[np.float64]:
    """Return theta when each message of a topic was received; NaN where not known.

    Its shape is (K,), of n > 1 knobs (K, n). The clock is the recorder's: state and theta may be
    stamped by others, or not at all.
    """
    fields = {measured: [LOG_TIME], **{c.topic: [LOG_TIME, *c.names] for c in commands}}
    columns = read_tables(bag, fields)  # in one pass
    received = columns[measured][LOG_TIME].astype(np.int64)
    return of_knobs(np.hstack([_held_at(columns[c.topic], received, c.names) for c in commands]))


def _held_at(
    columns: Columns, received: NDArray[np.int64], names: Sequence[str]
) -> NDArray[np.float64]:
    """Return the fields of a topic as they were last received at some times, shape (K, n)."""
    when = columns[LOG_TIME].astype(np.int64)
    if not when.size:
        return np.full((received.size, len(names)), np.nan)
    order = np.argsort(when, kind="stable")
    when, value = when[order], stack_numbers(columns, names)[order]
    usual = float(np.median(np.diff(when))) if when.size > 1 else np.inf
    place = np.searchsorted(when, received, side="right") - 1
    held, age = value[np.maximum(place, 0)], received - when[np.maximum(place, 0)]
    valid = (place >= 0) & (age <= max(READING.stale * usual, READING.stale_least * 1e9))
    return np.where(valid[:, None], held, np.nan)
