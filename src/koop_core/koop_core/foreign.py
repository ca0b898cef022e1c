"""C functions in compiled kernels, by their addresses: what numba keeps holds no address."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any


def call(function: int, first: int, second: int, third: int, fourth: int) -> int:
    """Call a C function that takes up to four pointers and returns an int, inside a kernel."""
    raise NotImplementedError("compiled kernels only")


def address_of(function: Any) -> int:
    """Return where a function of a library is."""
    return ctypes.cast(function, ctypes.c_void_p).value or 0


@cache
def libc(name: str) -> int:
    """Return the address of a function of libc."""
    return address_of(getattr(ctypes.CDLL(None), name))
