"""Sums of products of lifted states, the one expensive step of an identification.

States whose variables are the last samples of a few channels repeat themselves: what a monomial of
older samples is now, the same monomial of the samples after them was a step before. Let N be the
observables with a newest sample in them, S the others, and s(i) the observable i with every sample
one step newer, so that g_i(x_{k+1}) = g_s(i)(x_k) for i in S. With f and e the observables of the
first and of the last state,

    A_ij = G_s(i)j                               for i in S
    G_ij = A_is(j) + f_i f_j - e_i e_j           for i in N, j in S
    G_ij = G_s(i)s(j) + f_i f_j - e_i e_j        for i and j in S,

and only A_ij for i in N and G_ij for i and j in N are sums over the data: of 16 samples and degree
3, |N| = 153 of p = 969 and a ninth of the multiplications.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koopman_lifter.observables import Monomials

TILE_BYTES = 2**21  # of lifted states at a time: what a core's cache about holds
TILE = (2048, 20480)  # states at a time, at least for BLAS' sake, at most for the cache's
Sums = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


def products(observables: Monomials, states: NDArray[np.float64]) -> Sums:
    """Return G, A and L of the consecutive states of one trajectory, shape (n, M + 1)."""
    channels = delay_line(states)
    if channels and (sums := _of_a_delay_line(observables, states, channels)):
        return sums
    p = observables.p
    now_now, after_now = np.zeros((p, p)), np.zeros((p, p))
    for lifted in _tiles(observables, states):
        now, after = lifted[:, :-1], lifted[:, 1:]
        now_now += now @ now.T
        after_now += after @ now.T
    # L and G share all states but the first and the last, which makes a third product needless.
    # Where the first is most of an observable's sum, as in a state that dies away, taking it off
    # again would leave rounding errors; there the product is formed.
    first, last = observables.lift(states[:, 0]), observables.lift(states[:, -1])
    if np.all(2.0 * first**2 <= np.diag(now_now)):
        return now_now, after_now, now_now - np.outer(first, first) + np.outer(last, last)
    after_after = np.zeros((p, p))
    for lifted in _tiles(observables, states):
        after_after += lifted[:, 1:] @ lifted[:, 1:].T
    return now_now, after_now, after_after


def delay_line(states: NDArray[np.float64]) -> int:
    """Return of how many channels the variables are the last samples, newest first; 0: of none.

    Told from the values themselves, so that it is right whatever made them.
    """
    n, count = states.shape
    for channels in range(1, n // 2 + 1):
        if n % channels == 0 and count > 2:
            older, newer = states[channels:, 1:], states[:-channels, :-1]
            if np.array_equal(older[:, :9], newer[:, :9]) and np.array_equal(older, newer):
                return channels
    return 0


def _tiles(observables: Monomials, states: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    size = min(max(TILE[0], TILE_BYTES // (8 * observables.p)), TILE[1])
    room = np.empty((observables.p, min(size + 1, states.shape[1])))  # of every tile in turn
    for begin in range(0, states.shape[1] - 1, size):
        tile = states[:, begin : begin + size + 1]
        yield observables.lift(tile, room[:, : tile.shape[1]])


class _Shifts(NamedTuple):
    """How the observables of a delay line shift in time; indices, see the module."""

    newest: NDArray[np.int64]  # N, those with a newest sample in them
    older: NDArray[np.int64]  # S, the others
    newer: NDArray[np.int64]  # s(i) of those in S
    depths: list[NDArray[np.int64]]  # whose newest sample is at least 1, 2, ... steps old


@lru_cache(maxsize=8)
def _shifts(observables: Monomials, channels: int) -> _Shifts:
    exponents = observables.exponents
    count = observables.n // channels
    used = exponents.reshape(-1, count, channels).sum(axis=2) > 0
    depth = np.where(used.any(axis=1), used.argmax(axis=1), count)
    position = {tuple(row): i for i, row in enumerate(exponents.tolist())}
    zeros = [0] * channels
    newer = [
        position[tuple(row[channels:] + zeros)] if depth[i] else -1
        for i, row in enumerate(exponents.tolist())
    ]
    return _Shifts(
        np.flatnonzero(depth == 0),
        np.flatnonzero(depth > 0),
        np.array(newer),
        [np.flatnonzero(depth >= age) for age in range(1, count)],
    )


def _of_a_delay_line(
    observables: Monomials, states: NDArray[np.float64], channels: int
) -> Sums | None:
    """Return G, A and L; None where the ends are so much of the sums that rounding would show."""
    p, (newest, older, newer, depths) = observables.p, _shifts(observables, channels)
    of_newest = np.zeros((newest.size, newest.size))
    rows = np.zeros((newest.size, p))
    for lifted in _tiles(observables, states):
        leading = lifted[newest]
        rows += leading[:, 1:] @ lifted[:, :-1].T
        of_newest += leading[:, :-1] @ leading[:, :-1].T
    first, last = observables.lift(states[:, 0]), observables.lift(states[:, -1])
    ends = np.outer(first, first) - np.outer(last, last)
    now_now = np.empty((p, p))
    now_now[0, 0] = states.shape[1] - 1
    now_now[np.ix_(newest, newest)] = of_newest
    mixed = rows[:, newer[older]] + ends[np.ix_(newest, older)]
    now_now[np.ix_(newest, older)] = mixed
    now_now[np.ix_(older, newest)] = mixed.T
    for deep in depths:
        now_now[np.ix_(deep, deep)] = (
            now_now[np.ix_(newer[deep], newer[deep])] + ends[np.ix_(deep, deep)]
        )
    if np.any(2.0 * len(depths) * (first**2 + last**2) > np.diag(now_now)):
        return None
    after_now = now_now[newer]
    after_now[newest] = rows
    return now_now, after_now, now_now - ends
