"""``koop bench identify``: identification beside PyDMD and pykoop, on the same recording."""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

OURS = "koop"
NAMES = {
    OURS: "koop",
    "numpy": "numpy lstsq",
    "pykoop": "pykoop",
    "hankel_dmd": "PyDMD HankelDMD",
    "kernel_edmd": "PyDMD EDMD (kernel)",
}
DT = 0.05  # [s]


@dataclass(frozen=True)
class Case:
    """One identification.

    Attributes
    ----------
    delays, degree : int
        Samples of the channel that are the state, degree of their monomials.
    most : dict of str to int
        Snapshots that a tool gets, where it would need more memory than this machine has, or more
        than some minutes, for all of them.
    """

    delays: int
    degree: int
    most: dict[str, int]

    @property
    def observables(self) -> int:
        """p."""
        return math.comb(self.delays + self.degree, self.degree)


CASES = (
    Case(1, 3, {"kernel_edmd": 1000}),
    Case(4, 3, {"numpy": 500_000, "hankel_dmd": 500_000, "kernel_edmd": 1000}),
    Case(16, 1, {"kernel_edmd": 1000}),
    Case(16, 3, {"numpy": 10_000, "pykoop": 200_000, "hankel_dmd": 10_000, "kernel_edmd": 0}),
)


WORKLOADS = Path(__file__).parent / "workloads"


def register(benchmarks: Any) -> None:
    """Add the benchmark to the subparsers of ``koop bench``."""
    parser = benchmarks.add_parser("identify", help="identification beside PyDMD and pykoop")
    parser.add_argument(
        "--snapshots", type=int, default=2_000_000, metavar="N", help="of the recording"
    )
    parser.add_argument(
        "--share", type=float, default=1.0, metavar="X",
        help="of the snapshots that each tool gets (default 1; less is a quick look)",
    )  # fmt: skip
    parser.add_argument(
        "--python", type=Path, default=Path(sys.executable), metavar="FILE",
        help="Python that has PyDMD and pykoop, which need not be this one",
    )  # fmt: skip
    parser.add_argument(
        "--source", type=Path, default=WORKLOADS / "identify.py",
        metavar="FILE",
        help="what is measured",
    )  # fmt: skip
    parser.set_defaults(func=main)


@dataclass(frozen=True)
class Figures:
    """What one identification took: processor time [s], memory [B]; and its eigenvalues."""

    time: float
    memory: float
    eigenvalues: NDArray[np.complex128]


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code."""
    if not args.source.is_file():
        raise ValueError(f"{args.source} is not there: run this in the repository's root")
    check(args.python)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "samples.npy"
        np.save(file, recording(args.snapshots + max(case.delays for case in CASES)))
        print(
            "processor time on one thread, fastest run; memory beyond what was held before; "
            "ratios to koop on as many snapshots"
        )
        for case in CASES:
            one_case(args, file, case)
    return 0


def one_case(args: argparse.Namespace, file: Path, case: Case) -> None:
    """Measure and print one case."""
    print(
        f"\n{case.delays} sample{'s' * (case.delays > 1)} of one channel, degree {case.degree}: "
        f"{case.observables} observables\n{'':22}{'snapshots':>10}{'time':>11}{'memory':>11}"
        f"{'time':>8}{'memory':>8}{'spectrum differs by':>21}"
    )
    ours: dict[int, Figures] = {}

    def koop(snapshots: int) -> Figures:
        if snapshots not in ours:
            ours[snapshots] = measure(
                args.source, Path(sys.executable), OURS, file, case, snapshots
            )
            print(line(OURS, snapshots, ours[snapshots]), flush=True)
        return ours[snapshots]

    whole = round(args.snapshots * args.share)
    long, short = koop(whole), koop(whole // 2)
    for tool in NAMES:
        snapshots = min(whole, round(case.most.get(tool, args.snapshots) * args.share))
        if tool == OURS or snapshots <= case.observables:
            continue
        same = koop(snapshots)
        python = Path(sys.executable) if tool == "numpy" else args.python
        figures = measure(args.source, python, tool, file, case, snapshots)
        apart = difference(same.eigenvalues, figures.eigenvalues)
        print(
            line(tool, snapshots, figures)
            + f"{figures.time / same.time:8.1f}{figures.memory / max(same.memory, 1):8.1f}"
            + f"{apart:21.1e}",
            flush=True,
        )
    growth = long.memory / max(short.memory, 1)
    print(f"koop's memory for twice the snapshots: {growth:.2f} times as much")


def line(tool: str, snapshots: int, figures: Figures) -> str:
    """Return the columns that every tool has."""
    return f"  {NAMES[tool]:20}{snapshots:10d}{figures.time:9.3f} s{figures.memory / 1e6:8.1f} MB"


def check(python: Path) -> None:
    """Raise a ValueError unless that Python has what is compared."""
    command = [str(python), "-c", "import pydmd, pykoop"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        raise ValueError(f"--python {python}: {error.strerror}") from None
    if done.returncode:
        raise ValueError(
            f"{python} lacks PyDMD or pykoop, which are requirements of this benchmark only: make "
            "an environment (python -m venv DIR && DIR/bin/pip install pydmd pykoop) and give it "
            "with --python DIR/bin/python"
        )


def recording(count: int) -> NDArray[np.float64]:
    """Return samples of two tones with noise of a tenth, which excites every monomial."""
    t = DT * np.arange(count)
    noise = np.random.default_rng(0).normal(size=count)
    return np.asarray(np.cos(t) + 0.5 * np.cos(2.3 * t) + 0.1 * noise)


def measure(
    source: Path, python: Path, tool: str, file: Path, case: Case, snapshots: int
) -> Figures:
    """Identify in a process of its own, with one thread.

    Raises
    ------
    ValueError
        If it fails.
    """
    numbers = map(str, (case.delays, case.degree, snapshots))
    done = subprocess.run(
        [str(python), str(source), tool, str(file), *numbers],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
    )
    if done.returncode:
        raise ValueError(f"{NAMES[tool]}, {snapshots} snapshots: {done.stderr.strip()[-300:]}")
    said = json.loads(done.stdout)
    eigenvalues = np.array(said["real"]) + 1j * np.array(said["imag"])
    return Figures(said["time"], said["memory"], eigenvalues)


def difference(ours: NDArray[np.complex128], theirs: NDArray[np.complex128]) -> float:
    """Return the largest distance between two spectra, paired so that the distances are least.

    A tool without the constant observable lacks its eigenvalue.
    """
    from scipy.optimize import linear_sum_assignment

    distance = np.abs(ours[:, None] - theirs[None, :])
    return float(distance[linear_sum_assignment(distance)].max())
