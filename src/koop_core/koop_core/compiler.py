"""What of the kernels needs numba: imported when the first of them is called."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable
from contextlib import suppress
from typing import Any, ClassVar

import numba
from numba.core.caching import FunctionCache
from numba.core.runtime import rtsys
from numba.extending import intrinsic, overload

from koop_core.borrowed import borrowed


class _Cache(FunctionCache):  # type: ignore[misc]  # numba has no types
    """The compiled code of one kernel on the disk.

    Processes that need one at the same time compile it once: who does so locks the module, others
    wait. They cannot wait for each other, for modules do not import each other.
    """

    locks: ClassVar[dict[str, list[int]]] = {}  # descriptor and depth, by module

    def load_overload(self, signature: Any, context: Any) -> Any:
        rtsys.initialize(context)  # memory for arrays: all that a kept kernel needs
        if (kept := self._load_overload(signature, context)) is not None:
            return kept
        module = self._py_func.__code__.co_filename
        if module not in self.locks:
            self.locks[module] = [os.open(module, os.O_RDONLY), 0]
            with suppress(OSError):  # not everywhere can files be locked
                fcntl.flock(self.locks[module][0], fcntl.LOCK_EX)
        self.locks[module][1] += 1
        if (kept := self._load_overload(signature, context)) is not None:
            self._unlock(module)
        return kept

    def save_overload(self, signature: Any, data: Any) -> None:
        super().save_overload(signature, data)
        self._unlock(self._py_func.__code__.co_filename)

    def _unlock(self, module: str) -> None:
        self.locks[module][1] -= 1
        if not self.locks[module][1]:
            os.close(self.locks.pop(module)[0])


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
