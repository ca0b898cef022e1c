"""Identification beside NumPy's least squares on all of the lifted states, on the same recording.

Processor time on one thread of the fastest run; memory beyond what was held before. Each is
measured in a process of its own.
"""

from __future__ import annotations

import math
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from koop_bench.figures import BenchFigure, BenchSettings
from koopman_lifter.delays import Delays
from koopman_lifter.edmd import Gram, edmd
from koopman_lifter.observables import Monomials

SNAPSHOTS = 400_000
DT = 0.05  # [s]
DEGREE = 3  # of the monomials
# Samples of the channel that are the state, and the snapshots of which the lifted states fit into
# the memory of a machine at once.
CASES = {1: 400_000, 4: 100_000, 16: 10_000}
PART = 65536  # samples that koop reads at a time
RUNS = 7  # of which the fastest counts: a first one also compiles and loads
LONG = 10.0  # [s] of all runs; no other one follows


@dataclass(frozen=True)
class Identification:
    """Processor time [s] and memory [B] of one identification, and its eigenvalues."""

    time: float
    memory: float
    eigenvalues: NDArray[np.complex128]


def run(settings: BenchSettings) -> list[BenchFigure]:
    """Identify with one, few and many observables."""
    figures = []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "samples.npy"
        np.save(file, make_recording(SNAPSHOTS + max(CASES)))
        for delays, few in CASES.items():
            case = f"{math.comb(delays + DEGREE, DEGREE)} observables"
            whole = identify("koop", file, delays, SNAPSHOTS)
            ours, other = (identify(tool, file, delays, few) for tool in ("koop", "numpy"))
            settings.show(
                f"{case}: {SNAPSHOTS} snapshots in {whole.time:.3f} s and {whole.memory / 1e6:.1f} "
                f"MB; {few} in {ours.time:.3f} s and {ours.memory / 1e6:.1f} MB, NumPy "
                f"{other.time:.3f} s and {other.memory / 1e6:.1f} MB; spectra differ by "
                f"{difference(ours.eigenvalues, other.eigenvalues):.1e}"
            )
            what = f"{case}, {few} snapshots"
            figures.append(
                BenchFigure(what, f"{ours.time:.3f} s", ours.time / other.time, "numpy lstsq")
            )
    return figures


def make_recording(count: int) -> NDArray[np.float64]:
    """Return samples of two tones with noise of a tenth, which excites every monomial."""
    t = DT * np.arange(count)
    noise = np.random.default_rng(0).normal(size=count)
    return np.asarray(np.cos(t) + 0.5 * np.cos(2.3 * t) + 0.1 * noise)


def identify(tool: str, file: Path, delays: int, snapshots: int) -> Identification:
    """Identify in a process of its own, with one thread."""
    with ProcessPoolExecutor(1, get_context("spawn")) as process:
        return process.submit(measure, tool, file, delays, snapshots).result()


def difference(ours: NDArray[np.complex128], theirs: NDArray[np.complex128]) -> float:
    """Return the largest distance between two spectra, paired so that the distances are least."""
    from scipy.optimize import linear_sum_assignment

    distance = np.abs(ours[:, None] - theirs[None, :])
    return float(distance[linear_sum_assignment(distance)].max())


def with_koop(file: Path, delays: int, snapshots: int) -> NDArray[np.float64]:
    """Return the operator, part by part, as `koop train` reads a bag."""
    embedding, gram = Delays(1, delays), Gram.empty(Monomials(delays, DEGREE))
    samples = np.load(file, mmap_mode="r")[: snapshots + delays]
    for begin in range(0, snapshots, PART):
        gram.add_trajectory(embedding.embed(samples[None, begin : begin + PART + delays]))
    return edmd(gram).scaled


def with_numpy(file: Path, delays: int, snapshots: int) -> NDArray[np.float64]:
    """Return the operator by least squares on all of the lifted states."""
    samples = np.load(file)[: snapshots + delays]
    states = np.lib.stride_tricks.sliding_window_view(samples, delays).T[::-1].copy()
    lifted = Monomials(delays, DEGREE).lift(states)
    solution, *_ = np.linalg.lstsq(lifted[:, :-1].T, lifted[:, 1:].T, rcond=None)
    return np.asarray(solution, np.float64)


def measure(tool: str, file: Path, delays: int, snapshots: int) -> Identification:
    """Measure one tool, in this process."""
    operator = {"koop": with_koop, "numpy": with_numpy}[tool]
    best, total = np.inf, 0.0
    with threadpool_limits(1):
        for number in range(RUNS):
            before, begin = _peak(), time.process_time()
            eigenvalues = np.linalg.eigvals(operator(file, delays, snapshots))
            elapsed = time.process_time() - begin
            if not number:
                memory = _peak() - before
            best, total = min(best, elapsed), total + elapsed
            if total > LONG:
                break
    return Identification(best, memory, np.asarray(eigenvalues, np.complex128))


def _peak() -> int:
    """Return the most memory that this process has held [B]."""
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) * 1024
