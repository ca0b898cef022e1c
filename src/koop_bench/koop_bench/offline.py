"""The compiled closed loop beside C at -O2.

All times are processor time of one thread, so that other work on the machine counts little.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from koop_bench.figures import BenchFigure, BenchSettings
from koop_core.errors import KoopError
from koop_loop.kernel import LoopMemory
from koop_loop.loop import controller, initial_state, run_kernel
from koop_loop.training import TrainingConfig, train
from koopman_lifter import cost
from koopman_lifter.config import LifterConfig
from koopman_lifter.model import KoopmanModel
from relay_esc.config import EscConfig
from vdp_plant.config import PlantConfig

STEPS = 500_000  # 2500 s
ROUNDS = 15  # timed runs, the best one counts
SOURCE = Path(__file__).with_name("closed_loop.c")
PLANT, ESC = PlantConfig(), EscConfig()
Run = Callable[[], NDArray[np.float64]]
"""Runs a loop and returns theta of every step."""


def run(settings: BenchSettings) -> list[BenchFigure]:
    """Time kernel and C in turn, with either cost, so that other work disturbs both alike."""
    model = train(PLANT, TrainingConfig())
    rounds = settings.rounds or ROUNDS
    figures: list[BenchFigure] = []
    with tempfile.TemporaryDirectory() as folder:
        library = compile_c(SOURCE, Path(folder))
        for name in ("raw", "lifted"):
            loop = LifterConfig(cost=name), None if name == "raw" else model
            ours, theirs = kernel_run(*loop), c_run(*loop, library)
            worst = float(np.abs(ours() - theirs()).max())  # also compiles, and touches the memory
            times = [(time_of(ours), time_of(theirs)) for _ in range(rounds)]
            kernel, c = np.min(times, axis=0)
            settings.show(
                f"{name}: 2500 s closed loop, {STEPS} steps, best of {rounds}: kernel "
                f"{kernel:.3f} s, C -O2 {c:.3f} s; largest difference in theta {worst:g}"
            )
            title, took = f"speed of the kernel, {name}", f"{kernel:.3f} s"
            figures.append(BenchFigure(title, took, c / kernel, "C", worst < 1e-9))
    return figures


def time_of(function: Run) -> float:
    """Return the processor time of a call [s]."""
    begin = time.process_time()
    function()
    return time.process_time() - begin


def kernel_run(lifter: LifterConfig, model: KoopmanModel | None) -> Run:
    """Return the compiled loop."""
    parameters = controller(lifter, ESC, model)
    work = cost.workspace(parameters.lifting)
    buffers = (np.empty((STEPS, 2)), np.empty((STEPS, 2)), np.empty(STEPS), np.empty(STEPS))
    start = initial_state(PLANT)

    def once() -> NDArray[np.float64]:
        memory = LoopMemory(cost.initial(), ESC.initial())
        plant, first = PLANT.params(), memory.relay.output
        run_kernel(plant, None, parameters, None, first, memory, work, *start, *buffers)
        return buffers[-1]

    return once


def compile_c(source: Path, folder: Path) -> Path:
    """Compile the C source at -O2 to a library and return its path.

    Raises
    ------
    KoopError
        If there is no compiler, or it does not compile.
    """
    if shutil.which("cc") is None:
        raise KoopError("no C compiler 'cc' on the PATH to compare with")
    library = folder / "closed_loop.so"
    words = ["cc", "-O2", "-Wall", "-Wextra", "-fPIC", "-shared", "-o"]
    files = [str(library), str(source), "-lm"]
    done = subprocess.run([*words, *files], capture_output=True, text=True, check=False)
    if done.returncode:
        raise KoopError(f"{source} does not compile: {done.stderr.strip()}")
    return library


class CLifting(ctypes.Structure):
    """lifting_t of the C source."""

    _fields_ = (
        *((name, ctypes.c_long) for name in ("lifted", "p", "n")),
        *((name, ctypes.c_void_p) for name in ("parent", "factor", "projector")),
    )


def c_run(lifter: LifterConfig, model: KoopmanModel | None, library: Path) -> Run:
    """Return the loop in C."""
    lifting = cost.no_lifting() if model is None else model.lifting()
    rows, p = lifting.projector.shape
    arrays = [np.ascontiguousarray(array) for array in lifting[:3]]
    described = CLifting(lifter.source, p, rows, *(array.ctypes.data for array in arrays))
    # the structures of the source begin with the same numbers, in the same order
    parts = PLANT.params(), lifter.detector_params(), ESC.params(PLANT.dt)
    plant, detector, relay = ((ctypes.c_double * len(p))(*map(float, p)) for p in parts)
    start = (ESC.theta_initial, *initial_state(PLANT))
    buffers = [np.empty(size) for size in (p, 2 * STEPS, 2 * STEPS, STEPS, STEPS)]
    function = ctypes.CDLL(str(library)).run

    def once() -> NDArray[np.float64]:
        function(
            plant, ctypes.byref(described), detector, relay, *map(ctypes.c_double, start),
            ctypes.c_long(STEPS), *(ctypes.c_void_p(buffer.ctypes.data) for buffer in buffers),
        )  # fmt: skip
        assert arrays  # alive until here
        return buffers[-1]

    return once
