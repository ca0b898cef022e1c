"""What of the kernels needs numba: imported when the first of them is called."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable
from contextlib import suppress
from typing import Any, ClassVar

import numba
from numba import types
from numba.core import entrypoints, environment, ir
from numba.core.caching import FunctionCache
from numba.core.cgutils import ir as llvm  # llvmlite's, of which this is the one use
from numba.core.compiler_lock import global_compiler_lock
from numba.core.runtime import rtsys
from numba.extending import intrinsic, overload

from koop_core.borrowed import borrowed, is_of, load, overlay, store
from koop_core.foreign import call
from koop_core.named_tuple import replace

# A kernel that is inlined is copied block by block, with all its variables for each: a quarter of
# the time that a kernel takes to compile. What is copied is used once, and can share them.
ir.Scope.__deepcopy__ = lambda self, memo: self
# Numba would look through all that is installed for extensions of it; these kernels need none.
entrypoints._already_initialized = True
rebuild = environment._rebuild_env


def rebuild_environment(module: str, constants: Any, name: str) -> Any:
    """Return what a kept function has of Python: its constants, and globals that it never reads.

    A function of numba's own, such as an array's ``max``, would import its module for them, and
    with it most of the compiler.
    """
    return rebuild("numba" if module.startswith("numba.") else module, constants, name)


environment._rebuild_env = rebuild_environment


class _Cache(FunctionCache):  # type: ignore[misc]  # numba has no types
    """The compiled code of one kernel on the disk.

    Processes that need one at the same time compile it once: who does so locks the module, others
    wait. They cannot wait for each other, for modules do not import each other.
    """

    locks: ClassVar[dict[str, int]] = {}  # descriptors by module

    def __init__(self, dispatcher: Any) -> None:
        super().__init__(dispatcher.py_func)
        self._options = tuple(dispatcher.targetoptions)

    def _index_key(self, signature: Any, codegen: Any) -> Any:
        """Tell kernels of one closure by the types of their arguments: what it holds has a uuid."""
        return signature, codegen.magic_tuple(), self._py_func.__code__.co_code, self._options

    def load_overload(self, signature: Any, context: Any) -> Any:
        rtsys.initialize(context)  # memory for arrays: all that a kept kernel needs
        kept = self._load_overload(signature, context)
        module = self._py_func.__code__.co_filename
        if kept is not None or module in self.locks:
            return kept
        self.locks[module] = os.open(module, os.O_RDONLY)
        with suppress(OSError):  # not everywhere can files be locked
            fcntl.flock(self.locks[module], fcntl.LOCK_EX)
        return self._load_overload(signature, context)


def make_dispatcher(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    """Return what numba makes of a function that it is to compile and keep.

    What takes Python's objects apart is most of the code of a kernel with large tuples: it is left
    out of what other kernels call.
    """
    dispatcher = _make_dispatcher(function, no_cfunc_wrapper=True, **options)
    inner = _make_dispatcher(function, no_cfunc_wrapper=True, no_cpython_wrapper=True, **options)

    def find_plain_template(arguments: Any, keywords: Any) -> Any:
        plain = {name: _plain(kind) for name, kind in keywords.items()}
        return inner.get_call_template(tuple(map(_plain, arguments)), plain)

    dispatcher.get_call_template = find_plain_template
    dispatcher.get_overload = inner.get_overload
    return dispatcher


def _make_dispatcher(function: Callable[..., Any], **options: Any) -> Any:
    """Numba takes no other cache than its own: this is the one place that replaces it."""
    dispatcher = numba.njit(cache=True, **options)(function)
    dispatcher._cache = _Cache(dispatcher)
    compile_it = dispatcher.compile

    def compile_alone(signature: Any) -> Any:
        with global_compiler_lock:
            before = set(_Cache.locks)
            try:
                return compile_it(signature)
            finally:  # also where numba gives up or is interrupted
                for module in _Cache.locks.keys() - before:
                    os.close(_Cache.locks.pop(module))

    dispatcher.compile = compile_alone
    return dispatcher


def _plain(kind: Any) -> Any:
    """Return the type as which a kernel takes an argument from another kernel.

    Numba would compile a kernel again for each constant and each enumeration that is passed.
    """
    if isinstance(kind, types.IntEnumMember):
        return kind.dtype
    constant = isinstance(kind, (types.IntegerLiteral, types.BooleanLiteral))
    return types.unliteral(kind) if constant else kind


@overload(replace, strict=False)  # its parameters are the fields
def _replaced(state, **changes):  # type: ignore[no-untyped-def]
    values = (name if name in changes else f"state.{name}" for name in state.fields)
    space = {"made": state.instance_class}
    exec(f"def made_of(state, {', '.join(changes)}): return made({', '.join(values)})", space)
    return space["made_of"]


def _drop_owners(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """Return a value without the owners of all arrays that it holds."""
    if isinstance(kind, types.Array):
        view = context.make_array(kind)(context, builder, value)
        view.meminfo = view.meminfo.type(None)
        return view._getvalue()
    for i, each in enumerate(kind if isinstance(kind, types.BaseTuple) else ()):
        inner = _drop_owners(context, builder, each, builder.extract_value(value, i))
        value = builder.insert_value(value, inner, i)
    return value


@intrinsic
def _without_owners(typing: Any, lent: Any) -> Any:
    def made(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _drop_owners(context, builder, lent, arguments[0])

    return lent(lent), made


@overload(borrowed)
def _borrowed(lent):  # type: ignore[no-untyped-def]
    return lambda lent: _without_owners(lent)


@intrinsic
def _overlay(typing: Any, data: Any, at: Any, count: Any, dtype: Any) -> Any:
    kind = types.Array(dtype.dtype, 1, "C")

    def made(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        from numba.np.arrayobj import populate_array  # of which only the compiler knows

        source = context.make_array(data)(context, builder, arguments[0])
        view = context.make_array(kind)(context, builder)
        place = builder.bitcast(builder.gep(source.data, [arguments[1]]), view.data.type)
        size = context.get_abi_sizeof(context.get_data_type(kind.dtype))
        step = context.get_constant(types.intp, size)
        populate_array(view, place, [arguments[2]], [step], step, None)
        return view._getvalue()

    return kind(data, types.intp, types.intp, dtype), made


@overload(overlay)
def _overlaid(data, at, count, dtype):  # type: ignore[no-untyped-def]
    return lambda data, at, count, dtype: _overlay(data, at, count, dtype)


@overload(is_of)
def _is_of(value, kind):  # type: ignore[no-untyped-def]
    same = value == kind.instance_type
    return lambda value, kind: same


def _place(context: Any, builder: Any, memory: Any, kind: Any, arguments: Any) -> Any:
    """Return the pointer to a value of a type in an array of bytes."""
    view = context.make_array(memory)(context, builder, arguments[0])
    place = builder.gep(view.data, [arguments[1]])
    return builder.bitcast(place, context.get_value_type(kind).as_pointer())


@intrinsic
def _load(typing: Any, memory: Any, at: Any, kind: Any) -> Any:
    like = kind.instance_type

    def made(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        value = builder.load(_place(context, builder, memory, like, arguments))
        return _drop_owners(context, builder, like, value)

    return like(memory, types.intp, kind), made


@overload(load)
def _loaded(memory, at, kind):  # type: ignore[no-untyped-def]
    return lambda memory, at, kind: _load(memory, at, kind)


@intrinsic
def _store(typing: Any, memory: Any, at: Any, value: Any) -> Any:
    def made(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        lent = _drop_owners(context, builder, value, arguments[2])
        builder.store(lent, _place(context, builder, memory, value, arguments))
        return context.get_dummy_value()

    return types.void(memory, types.intp, value), made


@intrinsic
def _size(typing: Any, value: Any) -> Any:
    def made(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        size = context.get_abi_sizeof(context.get_value_type(value))
        return context.get_constant(types.intp, size)

    return types.intp(value), made


@overload(store)
def _stored(memory, at, value):  # type: ignore[no-untyped-def]
    def put(memory, at, value):  # type: ignore[no-untyped-def]
        if at + _size(value) > memory.size:
            raise ValueError("a value does not fit the memory that it is stored in")
        _store(memory, at, value)

    return put


@intrinsic
def _call(typing: Any, function: Any, first: Any, second: Any, third: Any, fourth: Any) -> Any:
    def made(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        word = llvm.IntType(64)
        kind = llvm.FunctionType(llvm.IntType(32), [word] * 4)
        return builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), arguments[1:])

    return types.int32(*[types.int64] * 5), made


@overload(call)
def _called(function, first, second, third, fourth):  # type: ignore[no-untyped-def]
    return lambda function, first, second, third, fourth: _call(
        function, first, second, third, fourth
    )
