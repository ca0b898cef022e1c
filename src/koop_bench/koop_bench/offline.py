"""The compiled closed loop beside plain Python and C at -O2.

All times are processor time of one thread, so that other work on the machine counts little.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from koop_bench.figures import BenchFigure, BenchSettings
from koop_core.errors import KoopError
from koop_loop.kernel import LoopMemory
from koop_loop.loop import controller, initial_state, run_kernel, simulate
from koop_loop.training import TrainingConfig, train
from koopman_lifter import cost
from koopman_lifter.config import LifterConfig
from koopman_lifter.model import KoopmanModel
from relay_esc.config import EscConfig
from vdp_plant.config import PlantConfig

STEPS = 500_000  # 2500 s
PYTHON_STEPS = 20_000  # plain Python is some hundred times slower; time a step does not depend on k
ROUNDS = 15  # timed runs, the best one counts
SOURCE = Path(__file__).with_name("closed_loop.c")
EVERY = 1000  # theta of every so many steps is compared with C


@dataclass(frozen=True)
class TimedLoop:
    """One closed loop to be timed."""

    lifter: LifterConfig
    model: KoopmanModel | None
    plant: PlantConfig = field(default_factory=PlantConfig)
    esc: EscConfig = field(default_factory=EscConfig)


def run(settings: BenchSettings) -> list[BenchFigure]:
    """Time the loop with either cost beside C and plain Python."""
    model = train(PlantConfig(), TrainingConfig())
    rounds = settings.rounds or ROUNDS
    program = None
    figures: list[BenchFigure] = []
    with tempfile.TemporaryDirectory() as folder:
        if shutil.which("cc") is None:
            settings.show("no C compiler 'cc' on the PATH: the comparison with C is left out")
        else:
            program = compile_c(SOURCE, Path(folder))
        for name in ("raw", "lifted"):
            loop = TimedLoop(LifterConfig(cost=name), None if name == "raw" else model)
            kernel, c, worst = compare(loop, program, rounds)
            python = time_python(name)
            settings.show(
                f"{name}: 2500 s closed loop, {STEPS} steps, best of {rounds}\n"
                f"  kernel        {kernel:8.3f} s   {STEPS / kernel / 1e6:.2f} million steps/s\n"
                f"  plain Python  {python:8.1f} s"
            )
            title, took = f"speed of the kernel, {name}", f"{kernel:.3f} s"
            figures.append(BenchFigure(title, took, python / kernel, "Python"))
            if program is not None:
                settings.show(f"  C -O2         {c:8.3f} s   largest difference in theta {worst:g}")
                figures.append(BenchFigure(title, took, c / kernel, "C", worst < 1e-9))
    return figures


def compare(loop: TimedLoop, program: Path | None, rounds: int) -> tuple[float, float, float]:
    """Time kernel and C in turn, so that other work of the machine disturbs both.

    Returns the best times [s], and the largest difference in theta; infinite and 0 without C.
    """
    times, worst = [], 0.0
    for _ in range(rounds):
        kernel, theta = time_kernel(loop, 1)
        c = np.inf
        if program is not None:
            c, theta_c = time_c(program, loop, 1)
            worst = max(worst, float(np.abs(theta - theta_c).max()))
        times.append((kernel, c))
    best = np.min(times, axis=0)
    return float(best[0]), float(best[1]), worst


def best_time(rounds: int, function: Callable[[], object]) -> float:
    """Return the least processor time [s]; a first call compiles and touches the memory."""
    times = []
    for _ in range(rounds + 1):
        begin = time.process_time()
        function()
        times.append(time.process_time() - begin)
    return min(times[1:], default=np.inf)


def time_kernel(loop: TimedLoop, rounds: int) -> tuple[float, NDArray[np.float64]]:
    """Return the best time [s] of the compiled loop, and theta of every 1000th step."""
    parameters = controller(loop.lifter, loop.esc, loop.model)
    work = cost.workspace(parameters.lifting)
    buffers = (np.empty((STEPS, 2)), np.empty((STEPS, 2)), np.empty(STEPS), np.empty(STEPS))
    start = initial_state(loop.plant)

    def once() -> None:
        memory = LoopMemory(cost.initial(), loop.esc.initial())
        run_kernel(loop.plant.params(), parameters, memory, work, *start, *buffers, None)

    return best_time(rounds, once), buffers[3][::EVERY]


def time_python(name: str) -> float:
    """Return the time [s] of the same source without compilation, scaled to the whole run."""
    done = subprocess.run(
        [sys.executable, "-m", "koop_bench.offline", name],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        check=True,
        capture_output=True,
        text=True,
    )
    return float(done.stdout) * STEPS / PYTHON_STEPS


def compile_c(source: Path, folder: Path) -> Path:
    """Compile the C program at -O2 and return its path.

    Raises
    ------
    KoopError
        If it does not compile.
    """
    program = folder / "closed_loop"
    done = subprocess.run(
        ["cc", "-O2", "-Wall", "-Wextra", "-o", str(program), str(source), "-lm"],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise KoopError(f"{source} does not compile: {done.stderr.strip()}")
    return program


def time_c(program: Path, loop: TimedLoop, rounds: int) -> tuple[float, NDArray[np.float64]]:
    """Return the best time [s] of the C loop, and theta of every 1000th step."""
    lifting = cost.no_lifting() if loop.model is None else loop.model.lifting()
    rows, p = lifting.projector.shape
    plant, detector = loop.plant.params(), loop.lifter.detector_params()
    relay = loop.esc.params()
    numbers = [
        STEPS, rounds, EVERY, *initial_state(loop.plant), loop.esc.theta_initial,
        *plant[: plant._fields.index("theta_min")],
        detector.alpha_hp, detector.alpha_lp, *relay[: relay._fields.index("largest_change")],
        loop.lifter.source, p, rows, *lifting.parent, *lifting.factor, *lifting.projector.ravel(),
    ]  # fmt: skip
    text = "\n".join(repr(float(number)) for number in numbers)
    done = subprocess.run([str(program)], input=text, capture_output=True, text=True, check=True)
    values = np.array([float(line) for line in done.stdout.split()])
    return float(values[0]), values[1:]


def _run_plain(name: str) -> None:
    """Print the time of the uncompiled loop; runs in a process of its own without numba's JIT."""
    plant = PlantConfig()
    model = None if name == "raw" else train(plant, TrainingConfig(trajectories=2, duration=2.0))
    begin = time.process_time()
    simulate(plant, LifterConfig(cost=name), EscConfig(), model, PYTHON_STEPS)
    print(time.process_time() - begin)


if __name__ == "__main__":
    _run_plain(sys.argv[1])
