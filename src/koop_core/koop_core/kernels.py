"""Compiled kernels that start quickly: what numba has kept is loaded without its compiler.

Before numba looks for a kept kernel it imports all that its compiler knows, SciPy's linear algebra
included: 0.4 s of a processor and 33 MB in every node and every command. What is kept needs none
of it. It is put off until something is to be compiled, when numba does it in any case.

Numba looks at the types of all arguments in every call. For named tuples that takes longer than the
kernel: 3 of 4 us for the controller's. A caller with the same types for ever leaves it out.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
from numba.core.caching import FunctionCache
from numba.core.runtime import rtsys
from numba.extending import intrinsic, overload


class _Cache(FunctionCache):  # type: ignore[misc]  # numba has no types
    """The compiled code of one kernel on the disk."""

    def load_overload(self, signature: Any, context: Any) -> Any:
        rtsys.initialize(context)  # memory for arrays: all that a kept kernel needs
        with self._guard_against_spurious_io_errors():
            return self._load_overload(signature, context)


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function, and keep it, as ``numba.njit(cache=True)`` does with these options.

    Numba takes no other cache than its own: this is the one place that replaces it.
    """

    def compiled(function: Callable[..., Any]) -> Any:
        kernel = numba.njit(cache=True, **options)(function)
        kernel._cache = _Cache(function)
        return kernel

    return compiled


def borrowed(array):  # type: ignore[no-untyped-def]  # numba compares signatures
    """Return an array without an owner, inside a kernel that keeps the owner alive.

    References to it are not counted. Numba counts those that it cannot prove to be in vain, as
    where functions that take arrays are inlined into the branches of a loop: two atomic operations
    each, which together may take longer than all that the loop computes.
    """
    return array


@intrinsic
def _without_owner(typing: Any, array: Any) -> Any:
    def made(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        view = context.make_array(array)(context, builder, arguments[0])
        view.meminfo = view.meminfo.type(None)
        return view._getvalue()

    return array(array), made


@overload(borrowed)
def _borrowed(array):  # type: ignore[no-untyped-def]
    return lambda array: _without_owner(array)


def direct(kernel: Any, *arguments: Any) -> Callable[..., Any]:
    """Return a kernel compiled for the types of some arguments, which looks at types no more.

    It is called with them once. The caller answers for the types from then on: of an array of
    another type or order, the kernel would read the bytes as if it had the right one.
    """
    kernel(*arguments)
    compiled = kernel.overloads[tuple(numba.typeof(argument) for argument in arguments)]
    return compiled.entry_point
