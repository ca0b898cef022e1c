"""C functions in compiled kernels, by their addresses: what numba keeps holds no address."""

from __future__ import annotations


def call(function: int, first: int, second: int, third: int, fourth: int) -> int:
    """Call a C function that takes up to four pointers and returns an int, inside a kernel."""
    raise NotImplementedError("compiled kernels only")
