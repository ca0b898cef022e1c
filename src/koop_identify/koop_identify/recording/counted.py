"""The time of samples that bear no stamp: counted, so that jitter of their reception is not a gap.

A source without stamps is taken to sample evenly, as the lifter takes it, which counts its
messages. Sample j is then received at t_j = t_0 + P (j + m_j) + l_j: P is the stream's mean period,
m_j the number of samples that are missing before it, l_j >= 0 how late transport and a busy host
made it. A late message, or a batch of them, is followed by a burst that makes up for it; for what
was lost or not sampled nothing does. So the smallest of the next K and of the last K values of
e_j = t_j - P (j + m_i) show how many samples are missing between i and i + 1:

    (min(e_i+1 ... e_i+K) - min(e_i-K+1 ... e_i)) / P,    K = 2 (t_i+1 - t_i) / P, at least 50
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import njit
from koop_identify.recording.samples import Batch
from koop_identify.settings import READING


def mean_period(time: NDArray[np.int64]) -> float:
    """Return the mean period [ns] of a stream, from the times of at least two of its samples.

    The median over spans: a pause does not count, and of batches only how often they come.
    """
    span = max(1, min(READING.span, time.size // 4))
    return float(np.median(time[span:] - time[:-span])) / span


def recount(
    batches: Iterable[Batch],
    period: float,
    spacing: float,
    least: int = READING.least,
    most: int = READING.most,
) -> Iterator[Batch]:
    """Yield consecutive batches with counted times in place of times of reception.

    The stream has a mean period P [ns]; in the result one sample follows the other, missing ones
    included, after ``spacing`` [ns]. So many samples, at least and at most, are looked at around a
    long wait.
    """
    waiting: deque[Batch] = deque()
    times: NDArray[np.int64] = np.empty(0, np.int64)  # of all that is looked at
    numbers: NDArray[np.int64] = np.empty(0, np.int64)  # of those before the first that waits

    def count_first() -> Batch:
        nonlocal times, numbers
        batch = waiting.popleft()
        begin, end = numbers.size, numbers.size + batch.time.size
        numbers = np.append(numbers, np.zeros(batch.time.size, np.int64))
        _number(times - times[0], numbers, begin, period, least, most)
        counted = np.round(numbers[begin:] * spacing).astype(np.int64)
        kept = max(0, end - most)
        times, numbers = times[kept:], numbers[kept:]
        return replace(batch, time=counted)

    for batch in batches:
        waiting.append(batch)
        times = np.append(times, batch.time)
        while waiting and times.size - numbers.size >= waiting[0].time.size + most:
            yield count_first()
    while waiting:
        yield count_first()


@njit()
def _number(
    times: NDArray[np.int64],
    numbers: NDArray[np.int64],
    begin: int,
    period: float,
    least: int,
    most: int,
) -> None:
    """Fill in the numbers from `begin` on, from the times of these samples and of later ones."""
    for i in range(max(begin, 1), numbers.size):  # the first one's is 0
        wait = (times[i] - times[i - 1]) / period
        numbers[i] = numbers[i - 1] + 1
        if wait < -READING.long:  # the clock was set back
            numbers[i] = numbers[i - 1] + round(wait)
        elif wait > READING.long:
            look = min(max(least, int(2.0 * wait)), most)
            usual = np.inf
            for j in range(max(0, i - look), i):
                usual = min(usual, times[j] - period * numbers[j])
            late, j, end = np.inf, i, i + look
            while j < min(end, times.size):
                again = (times[j] - times[j - 1]) / period
                if again > wait:  # the burst had to wait, too
                    wait, end = again, min(max(end, j + int(2.0 * again)), i + most)
                late = min(late, times[j] - period * (numbers[i] + j - i))
                j += 1
            lost = (late - usual) / period
            if lost >= READING.sure:
                numbers[i] += round(lost)
