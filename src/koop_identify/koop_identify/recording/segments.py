"""Samples to segments: states one Dt apart, never bridged across a gap.

A segment ends where the time between two samples is longer than the gap or not positive, where a
step is missing (`steps`; a gap that was asked for is bridged here, too), at a value that is not
finite and at the end of a bag. The time of a sample is its stamp; where there is none, samples are
counted (:mod:`koop_identify.recording.counted`): late messages make no gap.

The two ways from samples to states:

- `steps`: as they are; neighbours in step are neighbours in time. What a bridged gap lacks is
  interpolated.
- `linear`: interpolated on the grid t0 + j Dt of the segment; right for a smooth signal sampled at
  Dt or faster, with an error of h^2 |x''| / 8 between two samples h apart.

Neither filters: what lies above 1 / (2 Dt) in faster samples is folded down.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_identify.recording.counted import recount
from koop_identify.recording.samples import Batch
from koop_identify.settings import READING


@dataclass(frozen=True)
class Segmentation:
    """How samples become segments."""

    way: str
    """`steps` or `linear`."""
    dt: float
    """Time between two states [s]."""
    gap: float
    """Longest time between two samples that is bridged [s]."""
    period: float = 0.0
    """Mean time between two samples [s] if they are to be counted; 0: their time is known."""

    def timed(self, batches: Iterable[Batch]) -> Iterator[Batch]:
        """Yield consecutive batches with the times that count for the segments."""
        if not self.period:
            return iter(batches)
        return recount(batches, self.period * 1e9, counted_spacing(self.period, self.dt) * 1e9)


def counted_spacing(period: float, dt: float) -> float:
    """Return how far apart counted samples are taken to be [s]: dt, if their mean is about that.

    The lifter counts them, too, and takes them to be dt apart.
    """
    return dt if abs(period / dt - 1.0) < READING.even else period


class Segment(NamedTuple):
    """States one Dt apart, shape (n, M); of a long segment one part, which begins it or not."""

    states: NDArray[np.float64]
    begins: bool


class Segmenter:
    """Splits the samples of one bag into segments, and counts them.

    ``dropped`` are samples that are not finite, ``gaps`` places where the time between two samples,
    or their steps, ended a segment.
    """

    def __init__(self, segmentation: Segmentation) -> None:
        self.samples = self.dropped = self.count = self.gaps = 0
        self.segmentation = segmentation
        self._last: Batch | None = None  # the last sample, as a batch of one
        self._grid = (0, 0)  # beginning of the segment [ns], number of the next grid point

    def split(self, batch: Batch) -> Iterator[Segment]:
        """Yield what a batch adds."""
        if not batch.time.size:
            return
        time, x, step = batch.time, batch.x, batch.step
        self.samples += time.size
        if self._last is not None:
            time, x = np.append(self._last.time, time), np.vstack((self._last.x, x))
            if step is not None and self._last.step is not None:
                step = np.append(self._last.step, step)
        earlier = int(self._last is not None)
        self._last = Batch(time[-1:], None if step is None else step[-1:], x[-1:])
        finite = np.asarray(np.isfinite(x).all(axis=1), np.bool_)
        self.dropped += int(np.count_nonzero(~finite[earlier:]))
        neighbours = self._neighbours(time, step)
        self.gaps += int(np.count_nonzero(~neighbours))
        cut = ~neighbours | ~(finite[1:] & finite[:-1])
        bounds = [0, *(np.flatnonzero(cut) + 1).tolist(), time.size]
        for begin, end in pairwise(bounds):
            begins = begin > 0 or not earlier
            if finite[begin] and end > begin + (not begins):
                self.count += begins
                part = slice(begin, end)
                if step is None or self.segmentation.way != "steps":
                    states = self._states(time[part], x[part], begins)
                else:
                    states = _fill(step[part], x[part])[not begins :]
                if states.shape[0]:
                    yield Segment(states.T, begins)

    def described(self) -> dict[str, Any]:
        """Return how the samples became segments, for a model's provenance."""
        return {
            "states": self.samples,
            "segments": self.count,
            "gaps": self.gaps,
            "not_finite": self.dropped,
            "way": self.segmentation.way,
            "gap": self.segmentation.gap,
            "counted_period": self.segmentation.period,
        }

    def _neighbours(
        self, time: NDArray[np.int64], step: NDArray[np.int64] | None
    ) -> NDArray[np.bool_]:
        if self.segmentation.way == "steps":
            assert step is not None
            most = max(round(self.segmentation.gap / self.segmentation.dt), 1)
            return np.asarray((np.diff(step) > 0) & (np.diff(step) <= most))
        apart = np.diff(time)
        return np.asarray((apart > 0) & (apart <= self.segmentation.gap * 1e9))

    def _states(
        self, time: NDArray[np.int64], x: NDArray[np.float64], begins: bool
    ) -> NDArray[np.float64]:
        """Return the new states of a part of a segment, on the grid of its first sample."""
        start, number = (int(time[0]), 0) if begins else self._grid
        period = self.segmentation.dt * 1e9
        end = int((time[-1] - start) / period) + 2  # beyond the last sample, whatever the rounding
        grid = start + np.round(np.arange(number, end) * period).astype(np.int64)
        grid = grid[grid <= time[-1]]
        self._grid = (start, number + grid.size)
        before = np.clip(np.searchsorted(time, grid, side="right") - 1, 0, time.size - 1)
        after = np.minimum(before + 1, time.size - 1)
        span = np.maximum(time[after] - time[before], 1)
        weight = ((grid - time[before]) / span)[:, None]
        return np.asarray(x[before] * (1.0 - weight) + x[after] * weight)


def _fill(step: NDArray[np.int64], x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return samples, shape (M, n), of rising steps with those of missing steps interpolated."""
    steps = np.arange(step[0], step[-1] + 1)
    if steps.size == step.size:
        return x
    return np.column_stack([np.interp(steps, step, column) for column in x.T])
