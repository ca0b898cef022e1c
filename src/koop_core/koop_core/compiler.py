"""What of the kernels needs numba: imported when the first of them is called."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
from numba.core.caching import FunctionCache
from numba.core.runtime import rtsys
from numba.extending import intrinsic, overload

from koop_core.borrowed import borrowed


class _Cache(FunctionCache):  # type: ignore[misc]  # numba has no types
    """The compiled code of one kernel on the disk."""

    def load_overload(self, signature: Any, context: Any) -> Any:
        rtsys.initialize(context)  # memory for arrays: all that a kept kernel needs
        with self._guard_against_spurious_io_errors():
            return self._load_overload(signature, context)


def make_dispatcher(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    """Return what numba makes of a function that it is to compile and keep.

    Numba takes no other cache than its own: this is the one place that replaces it.
    """
    dispatcher = numba.njit(cache=True, **options)(function)
    dispatcher._cache = _Cache(function)
    return dispatcher


def signature_of(*arguments: Any) -> tuple[Any, ...]:
    """Return the types under which numba keeps the code for some arguments."""
    return tuple(numba.typeof(argument) for argument in arguments)


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
