"""Compiled kernels that start quickly: what numba has kept is loaded without its compiler.

Before numba looks for a kept kernel it imports all that its compiler knows, SciPy's linear algebra
included: 0.4 s of a processor and 33 MB in every node and every command. What is kept needs none
of it. It is put off until something is to be compiled, when numba does it in any case. Numba itself
takes 0.2 s: it is imported when the first kernel is called, and many programs call none.

Numba looks at the types of all arguments in every call. For named tuples that takes longer than the
kernel: 3 of 4 us for the controller's. A caller with the same types for ever leaves it out.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial, update_wrapper
from typing import Any


class Kernel:
    """A function that is compiled when it is called; else as numba's dispatcher of it."""

    def __init__(self, options: dict[str, Any], function: Callable[..., Any]) -> None:
        self._options = options
        update_wrapper(self, function)
        self.py_func = function

    @cached_property
    def dispatcher(self) -> Any:
        """What numba makes of it."""
        from koop_core.compiler import make_dispatcher

        return make_dispatcher(self.py_func, self._options)

    def __call__(self, *arguments: Any) -> Any:
        return self.dispatcher(*arguments)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.dispatcher, name)  # so numba takes it for one, in another kernel


def njit(**options: Any) -> Callable[[Callable[..., Any]], Kernel]:
    """Compile a function, and keep it, as ``numba.njit(cache=True)`` does with these options."""
    return partial(Kernel, options)


def direct(kernel: Kernel, *arguments: Any) -> Callable[..., Any]:
    """Return a kernel compiled for the types of some arguments, which looks at types no more.

    It is called with them once. The caller answers for the types from then on: of an array of
    another type or order, the kernel would read the bytes as if it had the right one.
    """
    from numba import typeof

    kernel(*arguments)
    compiled: Callable[..., Any] = kernel.overloads[tuple(map(typeof, arguments))].entry_point
    return compiled
