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


@dataclass(frozen=True)
class IdentificationCase:
    """One identification.

    Attributes
    ----------
    delays, degree : int
        Samples of the channel that are the state, degree of their monomials.
    limits : dict of str to int
        Snapshots for a tool that would need more memory than this machine has, or more than some
        minutes, for all of them.
    """

    delays: int
    degree: int
    limits: dict[str, int]

    @property
    def observables(self) -> int:
        """p."""
        return math.comb(self.delays + self.degree, self.degree)


CASES = (
    IdentificationCase(1, 3, {}),
    IdentificationCase(4, 3, {"numpy": 100_000, "hankel_dmd": 100_000}),
    IdentificationCase(16, 3, {"numpy": 10_000, "pykoop": 40_000, "hankel_dmd": 10_000}),
)


@dataclass(frozen=True)
class Identification:
    """Processor time [s] and memory [B] of one identification, and its eigenvalues."""

    time: float
    memory: float
    eigenvalues: NDArray[np.complex128]


def run(settings: BenchSettings) -> list[BenchFigure]:
    """Identify case by case with every tool that there is."""
    figures: list[BenchFigure] = []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "samples.npy"
        np.save(file, make_recording(SNAPSHOTS + max(case.delays for case in CASES)))
        for case in CASES:
            figures += run_case(settings, file, case)
    return figures


def run_case(settings: BenchSettings, file: Path, case: IdentificationCase) -> list[BenchFigure]:
    """Measure and print one case."""
    settings.show(
        f"\n{case.delays} sample{'s' * (case.delays > 1)} of one channel, degree {case.degree}: "
        f"{case.observables} observables\n{'':22}{'snapshots':>10}{'time':>11}{'memory':>11}"
        f"{'time':>8}{'memory':>8}{'spectrum differs by':>21}"
    )
    figures = []
    ours: dict[int, Identification] = {}
    for tool, label in OTHERS.items():
        snapshots = min(SNAPSHOTS, case.limits.get(tool, SNAPSHOTS))
        if snapshots not in ours:
            ours[snapshots] = identify(Path(sys.executable), OURS, file, case, snapshots)
            settings.show(columns(OURS, snapshots, ours[snapshots]))
        same = ours[snapshots]
        python = Path(sys.executable) if tool == "numpy" else settings.python
        try:
            other = identify(python, tool, file, case, snapshots)
        except KoopError as error:
            settings.show(f"  {label:20}left out: {error}")
            continue
        settings.show(
            columns(label, snapshots, other)
            + f"{other.time / same.time:8.1f}{other.memory / max(same.memory, 1):8.1f}"
            + f"{difference(same.eigenvalues, other.eigenvalues):21.1e}"
        )
        what = f"{case.observables} observables, {snapshots} snapshots"
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
    python: Path, tool: str, file: Path, case: IdentificationCase, snapshots: int
) -> Identification:
    """Identify in a process of its own, with one thread.

    Raises
    ------
    KoopError
        If it fails, or the tool is not installed there.
    """
    numbers = map(str, (case.delays, case.degree, snapshots))
    done = subprocess.run(
        [str(python), str(TOOL), tool, str(file), *numbers],
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
