"""Laws of other programs: they are told a settled cost and say where theta rests next.

They run in a process of their own, with a Python that has their packages.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Generator
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import ConfigError
from koop_study.laws.catalogue import Constants
from koop_study.laws.loop import FLOOR, LoopState
from koop_study.laws.plants import Setting

SOURCE = Path("benchmarks/laws.py")  # of the repository, in whose root the study runs
NEEDED = {"optuna": "optuna", "cern": "cernml.extremum_seeking"}

Go = Callable[[LoopState, int, int], LoopState]
Asking = Generator[float, float, None]  # says u, is told the cost


def check(python: str, laws: list[str]) -> None:
    """Raise ConfigError unless that Python has the packages of these laws."""
    if not SOURCE.is_file():
        raise ConfigError(f"{SOURCE} is not there: run this in the repository's root")
    command = [python, "-c", "\n".join(f"import {NEEDED[law]}" for law in laws)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        raise ConfigError(f"--rivals {python}: {error.strerror}") from None
    if done.returncode:
        raise ConfigError(
            f"{python} lacks Optuna or CERN's extremum seeking: make an environment (python -m "
            "venv DIR && DIR/bin/pip install -r requirements/rivals.txt) and give it with --rivals "
            "DIR/bin/python"
        )


@lru_cache(maxsize=1)
def _process(python: str) -> subprocess.Popen[str]:
    """Start the other program; it ends when its input does, with this process."""
    return subprocess.Popen(
        [python, str(SOURCE)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )


def rival(python: str, law: str, constants: Constants, u: float, seed: int) -> Asking:
    """Talk to a law of another program."""
    process = _process(python)
    assert process.stdin
    assert process.stdout
    said: object = {"law": law, "constants": constants, "u": u, "seed": seed}
    while True:
        process.stdin.write(json.dumps(said) + "\n")
        process.stdin.flush()
        line = process.stdout.readline()
        if not line:
            raise RuntimeError(f"{python} {SOURCE} ended: {law} cannot be run")
        said = yield float(json.loads(line))


def ask_and_tell(
    asking: Asking,
    hold: float,
    plant: Setting,
    begin: int,
    go: Go,
    state: LoopState,
    r: NDArray[np.float64],
) -> None:
    """Run one law: theta rests for ``hold`` [s], the cost is that of the second half.

    Parameters
    ----------
    asking : generator
        Says u and is told the mean of log r, its sign changed where r is to be maximised.
    begin : int
        Step from which on there is a cost.
    go : callable
        Runs the loop from a state between two steps.
    r : ndarray, shape (M,)
        What ``go`` fills.
    """
    steps = max(2, round(hold / plant.dt))
    first = min(begin, plant.steps)
    state = go(state, 0, first)
    u = next(asking)
    while first < plant.steps:
        last = min(first + steps, plant.steps)
        state = go(state._replace(u=min(max(u, 0.0), 1.0)), first, last)
        costs = r[first + steps // 2 : last]
        costs = costs[np.isfinite(costs)]
        first = last
        if first < plant.steps and costs.size:
            u = asking.send(plant.sense * float(np.mean(np.log(np.maximum(costs, FLOOR)))))
