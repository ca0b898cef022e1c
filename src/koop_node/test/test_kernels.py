"""Kernels that numba has kept: quick to load, and the same as those that it compiles."""

import subprocess
import sys

KERNELS = """
from typing import NamedTuple

import numpy as np

from koop_node.kernels import njit


class State(NamedTuple):
    position: float
    history: np.ndarray


@njit()
def step(state, dt):
    history = np.empty_like(state.history)  # memory of its own
    history[:-1] = state.history[1:]
    history[-1] = state.position
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
        done = subprocess.run(
            [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, check=True
        )
        return done.stdout.splitlines()

    compiled, result = said(KEPT)
    assert compiled == "0 True"
    loaded, again, later = said(LATER)
    assert loaded == "1 False"
    assert result == again == "1.125 [2.0, 2.0, 1.5]"
    assert later == "3.1875 True"  # 1.5 + 1.125 + 0.5625
