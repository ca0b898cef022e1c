"""Samples to segments: states one Dt apart, never bridged across a gap.

A segment ends where a step is missing or goes back (`steps`), where the time between two samples is
longer than the gap or not positive (`linear`), at a value that is not finite, at the end of a bag,
and where training and held-out data meet. The time of a sample is its stamp; where there is
none, samples are counted (:mod:`koop_identify.recording.counted`): late messages make no gap.

The two ways from samples to states:

- `steps`: as they are; neighbours in step are neighbours in time.
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

EVEN = 0.05  # share of dt by which the mean period of counted samples may differ and count as dt
BLOCKS = 20  # of a bag; training and held-out data alternate in blocks, so that both see all of it


@dataclass(frozen=True)
class Segmentation:
    """How samples become segments.

    Attributes
    ----------
    way : str
        `steps` or `linear`.
    dt : float
        Time between two states [s].
    gap : float
        Longest time between two samples that is bridged [s]; not used with `steps`.
    held_out : float
        Share of the blocks that are held out, 0 to 0.5.
    period : float
        Mean time between two samples [s] if they are to be counted; 0: their time is known.
    """

    way: str
    dt: float
    gap: float
    held_out: float = 0.0
    period: float = 0.0

    def timed(self, batches: Iterable[Batch]) -> Iterator[Batch]:
        """Yield consecutive batches with the times that count for the segments."""
        if not self.period:
            return iter(batches)
        return recount(batches, self.period * 1e9, counted_spacing(self.period, self.dt) * 1e9)

    def is_held_out(self, block: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which blocks are held out: evenly spread, the first one never."""
        reached = np.floor(np.stack((block, block + 1)) * self.held_out + 1e-9)
        held: NDArray[np.bool_] = reached[1] > reached[0]
        return held


def counted_spacing(period: float, dt: float) -> float:
    """Return how far apart counted samples are taken to be [s]: dt, if their mean is about that.

    The lifter counts them, too, and takes them to be dt apart.
    """
    return dt if abs(period / dt - 1.0) < EVEN else period


class Segment(NamedTuple):
    """States one Dt apart, shape (n, M); of a long segment one part, which begins it or not.

    ``time`` belongs to the first state that was not in an earlier part [ns].
    """

    states: NDArray[np.float64]
    time: int
    begins: bool
    held_out: bool


class Segmenter:
    """Splits the samples of one bag into segments.

    Parameters
    ----------
    segmentation : Segmentation
        How.
    samples : int
        Number of them in the bag.

    Attributes
    ----------
    segmentation : Segmentation
        As given.
    dropped : int
        Samples that are not finite.
    count : int
        Number of segments so far.
    gaps : int
        Places so far where the time between two samples, or their steps, ended a segment.
    used : int
        Samples so far that have a neighbour in their segment.
    """

    def __init__(self, segmentation: Segmentation, samples: int) -> None:
        self.dropped = self.count = self.gaps = self.used = 0
        self.segmentation, self._samples = segmentation, max(samples, 1)
        self._last: Batch | None = None  # the last sample, as a batch of one
        self._alone = False  # whether the last segment has one sample
        self._grid = (0, 0)  # beginning of the segment [ns], number of the next grid point

    def split(self, batch: Batch) -> Iterator[Segment]:
        """Yield what a batch adds."""
        if not batch.time.size:
            return
        time, x, step = batch.time, batch.x, batch.step
        first = batch.index
        if self._last is not None:
            first -= 1
            time, x = np.append(self._last.time, time), np.vstack((self._last.x, x))
            if step is not None and self._last.step is not None:
                step = np.append(self._last.step, step)
        earlier = int(self._last is not None)
        self._last = Batch(0, time[-1:], None if step is None else step[-1:], x[-1:])
        finite = np.asarray(np.isfinite(x).all(axis=1), np.bool_)
        self.dropped += int(np.count_nonzero(~finite[earlier:]))
        held = self.segmentation.is_held_out(
            (first + np.arange(time.size)) * BLOCKS // self._samples  # block of every sample
        )
        neighbours = self._neighbours(time, step)
        self.gaps += int(np.count_nonzero(~neighbours))
        cut = ~neighbours | (held[1:] != held[:-1]) | ~(finite[1:] & finite[:-1])
        bounds = [0, *(np.flatnonzero(cut) + 1).tolist(), time.size]
        for begin, end in pairwise(bounds):
            begins = begin > 0 or not earlier
            if finite[begin] and end > begin + (not begins):
                self.count += begins
                pairs = end - begin - 1
                self.used += pairs + (pairs > 0 and (begins or self._alone))
                self._alone = begins and not pairs
                part = slice(begin, end)
                states, start = self._states(time[part], x[part], begins)
                if states.shape[0]:
                    yield Segment(states.T, start, begins, bool(held[begin]))

    def described(self) -> dict[str, Any]:
        """Return how the samples became segments, for a model's provenance."""
        return {
            "states": self._samples,
            "used": self.used,
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
            return np.asarray(np.diff(step) == 1)
        apart = np.diff(time)
        return np.asarray((apart > 0) & (apart <= self.segmentation.gap * 1e9))

    def _states(
        self, time: NDArray[np.int64], x: NDArray[np.float64], begins: bool
    ) -> tuple[NDArray[np.float64], int]:
        """Return the new states of a part of a segment, and the time of the first of them [ns].

        Unless the segment begins here, the first sample is known.
        """
        if self.segmentation.way == "steps":
            new = 0 if begins else 1
            return x[new:], int(time[min(new, time.size - 1)])
        start, number = (int(time[0]), 0) if begins else self._grid
        period = self.segmentation.dt * 1e9
        end = int((time[-1] - start) / period) + 2  # beyond the last sample, whatever the rounding
        grid = start + np.round(np.arange(number, end) * period).astype(np.int64)
        grid = grid[grid <= time[-1]]
        self._grid = (start, number + grid.size)
        first = int(grid[0]) if grid.size else 0
        before = np.clip(np.searchsorted(time, grid, side="right") - 1, 0, time.size - 1)
        after = np.minimum(before + 1, time.size - 1)
        span = np.maximum(time[after] - time[before], 1)
        weight = ((grid - time[before]) / span)[:, None]
        return np.asarray(x[before] * (1.0 - weight) + x[after] * weight), first
