"""Identification beside NumPy, PyDMD and pykoop, on the same recording.

Processor time on one thread of the fastest run; memory beyond what was held before.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from koop_bench.figures import BenchFigure, BenchSettings
from koop_core.errors import KoopError

OURS = "koop"
OTHERS = {"numpy": "numpy lstsq", "pykoop": "pykoop", "hankel_dmd": "PyDMD HankelDMD"}
TOOL = Path(__file__).with_name("identify_tool.py")
SNAPSHOTS = 400_000
DT = 0.05  # [s]


DEGREE = 3  # of the monomials
# Samples of the channel that are the state, and the snapshots for a tool that would need more
# memory than this machine has, or more than some minutes, for all of them.
CASES: dict[int, dict[str, int]] = {
    1: {},
    4: {"numpy": 100_000, "hankel_dmd": 100_000},
    16: {"numpy": 10_000, "pykoop": 40_000, "hankel_dmd": 10_000},
}


@dataclass(frozen=True)
class Identification:
    """Processor time [s] and memory [B] of one identification, and its eigenvalues."""

    time: float
    memory: float
    eigenvalues: NDArray[np.complex128]


def run(settings: BenchSettings) -> list[BenchFigure]:
    """Identify case by case with every tool that there is."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "samples.npy"
        np.save(file, make_recording(SNAPSHOTS + max(CASES)))
        return [figure for delays in CASES for figure in run_case(settings, file, delays)]


def run_case(settings: BenchSettings, file: Path, delays: int) -> list[BenchFigure]:
    """Measure and print one case."""
    observables = math.comb(delays + DEGREE, DEGREE)
    settings.show(
        f"\n{delays} sample{'s' * (delays > 1)} of one channel, degree {DEGREE}: "
        f"{observables} observables\n{'':22}{'snapshots':>10}{'time':>11}{'memory':>11}"
        f"{'time':>8}{'memory':>8}{'spectrum differs by':>21}"
    )
    figures = []
    ours: dict[int, Identification] = {}
    for tool, label in OTHERS.items():
        snapshots = CASES[delays].get(tool, SNAPSHOTS)
        case = (file, delays, DEGREE, snapshots)
        if snapshots not in ours:
            ours[snapshots] = identify(Path(sys.executable), OURS, *case)
            settings.show(columns(OURS, snapshots, ours[snapshots]))
        same = ours[snapshots]
        python = Path(sys.executable) if tool == "numpy" else settings.python
        try:
            other = identify(python, tool, *case)
        except KoopError as error:
            settings.show(f"  {label:20}left out: {error}")
            continue
        settings.show(
            columns(label, snapshots, other)
            + f"{other.time / same.time:8.1f}{other.memory / max(same.memory, 1):8.1f}"
            + f"{difference(same.eigenvalues, other.eigenvalues):21.1e}"
        )
        what = f"{observables} observables, {snapshots} snapshots"
        figures.append(BenchFigure(what, f"{same.time:.3f} s", same.time / other.time, label))
    return figures


def columns(label: str, snapshots: int, result: Identification) -> str:
    """Return the columns that every tool has."""
    return f"  {label:20}{snapshots:10d}{result.time:9.3f} s{result.memory / 1e6:8.1f} MB"


def make_recording(count: int) -> NDArray[np.float64]:
    """Return samples of two tones with noise of a tenth, which excites every monomial."""
    t = DT * np.arange(count)
    noise = np.random.default_rng(0).normal(size=count)
    return np.asarray(np.cos(t) + 0.5 * np.cos(2.3 * t) + 0.1 * noise)


def identify(
    python: Path, tool: str, file: Path, delays: int, degree: int, snapshots: int
) -> Identification:
    """Identify in a process of its own, with one thread, as ``identify_tool`` takes the words.

    Raises KoopError if it fails, or the tool is not installed there.
    """
    words = map(str, (python, TOOL, tool, file, delays, degree, snapshots))
    done = subprocess.run(
        list(words),
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
    )
    if done.returncode:
        raise KoopError(done.stderr.strip()[-300:])
    result = json.loads(done.stdout)
    eigenvalues = np.array(result["real"]) + 1j * np.array(result["imag"])
    return Identification(result["time"], result["memory"], eigenvalues)


def difference(ours: NDArray[np.complex128], theirs: NDArray[np.complex128]) -> float:
    """Return the largest distance between two spectra, paired so that the distances are least.

    A tool without the constant observable lacks its eigenvalue.
    """
    from scipy.optimize import linear_sum_assignment

    distance = np.abs(ours[:, None] - theirs[None, :])
    return float(distance[linear_sum_assignment(distance)].max())
