"""Arrays that a compiled kernel borrows from their owner."""

from __future__ import annotations


def borrowed(lent):  # type: ignore[no-untyped-def]  # numba compares signatures
    """Return arrays without an owner, inside a kernel that keeps the owner alive.

    ``lent`` is an array or a named tuple of arrays, numbers and such tuples.

    References to it are not counted. Numba counts those that it cannot prove to be in vain, as
    where functions that take arrays are inlined into the branches of a loop: two atomic operations
    each, which together may take longer than all that the loop computes.
    """
    return lent


def overlay(data, at, count, dtype):  # type: ignore[no-untyped-def]
    """Return so many values of a type that lie in an array of bytes, borrowed as above."""
    return data[at : at + count * dtype(0).itemsize].view(dtype)
