"""Kernels that numba has kept: quick to load, and the same as those that it compiles."""

import fcntl
import subprocess
import sys
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
import pytest

from koop_core.borrowed import borrowed
from koop_core.config.parameter import Settings, constants, parameter
from koop_core.kernels import direct, njit
from koop_core.named_tuple import replace

KERNELS = """
from typing import NamedTuple

import numpy as np

from koop_core.kernels import njit


class State(NamedTuple):
    position: float
    history: np.ndarray


@njit()
def step(state, dt):
    history = np.empty_like(state.history)  # memory of its own
    history[:-1] = state.history[1:]
    history[-1] = min(state.position, state.history.max())  # numba has max in another module
    return State(state.position * (1.0 - dt), history)
"""
KEPT = """
import sys
import numpy as np
import kernels
state = kernels.State(2.0, np.arange(3.0))
for _ in range(2):
    state = kernels.step(state, 0.25)
print(sum(kernels.step.stats.cache_hits.values()), "numba.np.linalg" in sys.modules)
print(state.position, state.history.tolist())
"""
LATER = (  # what is compiled in the same process, with one that was kept
    KEPT
    + """
@kernels.njit()
def twice(state, dt):
    return kernels.step(kernels.step(state, dt), dt).history.sum()

print(twice(state, 0.5), "numba.np.linalg" in sys.modules)
"""
)


def test_a_kernel_that_was_kept_is_loaded_without_the_compiler(tmp_path):
    (tmp_path / "kernels.py").write_text(KERNELS)

    def said(script):
        (tmp_path / "script.py").write_text(script)
        words = [sys.executable, "script.py"]
        both = [
            subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.PIPE, text=True)
            for _ in range(2)
        ]
        return sorted(process.communicate()[0] for process in both)

    first, second = (lines.splitlines() for lines in said(KEPT))
    assert [first[0], second[0]] == ["0 True", "1 False"]  # one of them has compiled it
    result = first[1]
    loaded, again, later = said(LATER)[1].splitlines()  # of the one that has compiled it
    assert loaded == "1 False"
    assert result == again == "1.125 [2.0, 2.0, 1.5]"
    assert later == "3.1875 True"  # 1.5 + 1.125 + 0.5625


@njit()
def broken(x):
    return x + "1"


def test_a_kernel_that_cannot_be_compiled_keeps_no_other_process_waiting():
    with pytest.raises(numba.TypingError):
        broken(1.0)
    with open(__file__) as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


class Pair(NamedTuple):
    a: float
    b: int


@njit()
def moved(pair, x, by):
    x[0] += by
    return Pair(pair.a * by, pair.b + 1), bool(by > 1.0)


def test_a_direct_kernel_answers_as_the_kernel_does():
    x, expected = np.zeros(2), np.zeros(2)
    kernel = direct(moved, Pair(1.0, 2), x, 0.0)
    for by in (0.5, 2.0, 3):  # a whole number where there was a float is one
        actual = kernel(Pair(2.0, 7), x, by)
        assert actual == moved(Pair(2.0, 7), expected, float(by))
        assert [type(item) for item in actual] == [Pair, bool]
    assert x.tolist() == expected.tolist() == [5.5, 0.0]


@njit()
def filled(x, rows):
    view = borrowed(x)
    for i in range(view.shape[0]):
        row = view[i]
        if rows[i]:
            row[:] = i
    return view[:, 0].sum()


@pytest.mark.parametrize("x", [np.zeros((4, 3)), np.zeros((3, 4)).T, np.zeros((8, 3))[::2]])
def test_a_borrowed_array_is_the_owners_memory(x):
    references = sys.getrefcount(x)
    for _ in range(100):
        assert filled(x, np.array([True, False, True, True])) == 5.0
    assert x.tolist() == [[0.0] * 3, [0.0] * 3, [2.0] * 3, [3.0] * 3]
    assert sys.getrefcount(x) == references


@dataclass(frozen=True)
class Example(Settings):
    share: float = parameter(0.1, "share", low=0.0, high=1.0)
    count: int = parameter(3, "count", low=1)


def test_a_kernel_takes_settings_as_constants_of_their_types() -> None:
    settings = constants(Example(share=0.7))

    def product(x: float) -> float:
        return x * settings.share + settings.count % 2

    assert numba.njit(product)(0.3) == product(0.3) == 0.3 * 0.7 + 1
    assert (type(settings.share), type(settings.count)) == (float, int)


class Level(NamedTuple):
    mean: float
    count: int
    history: np.ndarray


def test_a_kernel_replaces_fields_of_a_named_tuple_as_python_does_and_keeps_the_others():
    @njit()
    def take(level, x):
        level = replace(level, count=level.count + 1, mean=0.5 * (level.mean + x))
        return replace(level, history=level.history + x)

    before = Level(1.0, 2, np.arange(3.0))
    for after in (take(before, 4.0), take.py_func(before, 4.0)):
        assert after[:2] == (2.5, 3)
        assert after.history.tolist() == [4.0, 5.0, 6.0]
    assert before.history.tolist() == [0.0, 1.0, 2.0]
