"""Arrays and other values that a compiled kernel borrows from their owner."""

from __future__ import annotations


def borrowed(lent):  # type: ignore[no-untyped-def]  # numba compares signatures
    """Return arrays without an owner, inside a kernel that keeps the owner alive.

    ``lent`` is an array or a tuple, named or not, of arrays, numbers and such tuples.

    References to it are not counted. Numba counts those that it cannot prove to be in vain, as
    where functions that take arrays are inlined into the branches of a loop: two atomic operations
    each, which together may take longer than all that the loop computes.
    """
    return lent


def overlay(data, at, count, dtype):  # type: ignore[no-untyped-def]
    """Return so many values of a type that lie in an array of bytes, borrowed as above."""
    return data[at : at + count * dtype(0).itemsize].view(dtype)


def kind_of(value):  # type: ignore[no-untyped-def]
    """Return the type of a value as an argument for kernels."""
    from numba import typeof, types

    return types.TypeRef(typeof(value))


def is_of(value, kind):  # type: ignore[no-untyped-def]
    """Return whether a value is of a type, inside a kernel."""
    raise NotImplementedError("compiled kernels only")


def load(memory, at, kind):  # type: ignore[no-untyped-def]
    """Return the value of a type that :func:`store` put at a place of an array, borrowed."""
    raise NotImplementedError("compiled kernels only")


def store(memory, at, value):  # type: ignore[no-untyped-def]
    """Put a number, an array or a tuple of such at a place of an array of bytes, borrowed.

    Raises ValueError if it does not fit.
    """
    raise NotImplementedError("compiled kernels only")
