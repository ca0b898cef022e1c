"""One measurement of `koop bench identify`, in a process of its own.

Run as ``python identify_tool.py TOOL FILE DELAYS DEGREE SNAPSHOTS``; prints a line of JSON:
processor time of the fastest run [s], peak of memory above what was there before [B], eigenvalues.
FILE holds the samples of one channel (NumPy). PyDMD and pykoop are requirements of this benchmark
only.
"""

from __future__ import annotations

import json
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

PART = 65536  # samples that koop reads at a time
RUNS = 7  # of which the fastest counts: a first one also compiles and loads
LONG = 10.0  # [s] of all runs; no other one follows
Spectrum = Any


def koop(file: Path, delays: int, degree: int, snapshots: int) -> Callable[[], Spectrum]:
    """Part by part, as `koop train` reads a bag."""
    from koopman_lifter.delays import Delays
    from koopman_lifter.edmd import Gram, edmd
    from koopman_lifter.observables import Monomials

    def run() -> Spectrum:
        embedding, gram = Delays(1, delays), Gram.empty(Monomials(delays, degree))
        left = snapshots + delays
        with file.open("rb") as stream:
            np.lib.format.read_magic(stream)
            np.lib.format.read_array_header_1_0(stream)
            samples: Any = np.empty(0)
            while left:
                more = np.fromfile(stream, count=min(left, PART))
                left -= more.size
                samples = np.concatenate((samples[-delays:], more))
                gram.add_trajectory(embedding.embed(samples[None]))
        return np.linalg.eigvals(edmd(gram).scaled)

    return run


def numpy(file: Path, delays: int, degree: int, snapshots: int) -> Callable[[], Spectrum]:
    """Least squares on all of the lifted states."""
    from koopman_lifter.observables import Monomials

    def run() -> Spectrum:
        lifted = Monomials(delays, degree).lift(_embedded(file, delays, snapshots))
        solution, *_ = np.linalg.lstsq(lifted[:, :-1].T, lifted[:, 1:].T, rcond=None)
        return np.linalg.eigvals(solution)

    return run


def pykoop(file: Path, delays: int, degree: int, snapshots: int) -> Callable[[], Spectrum]:
    """A pipeline of delays, monomials and EDMD."""
    import pykoop

    def run() -> Spectrum:
        functions = [
            ("monomials", pykoop.PolynomialLiftingFn(degree)),
            ("one", pykoop.ConstantLiftingFn()),
        ]
        if delays > 1:
            functions.insert(0, ("delays", pykoop.DelayLiftingFn(delays - 1, 0)))
        pipeline = pykoop.KoopmanPipeline(functions, pykoop.Edmd(alpha=0))
        samples = np.load(file)[: snapshots + delays]
        pipeline.fit(samples[:, None], n_inputs=0, episode_feature=False)
        return np.linalg.eigvals(pipeline.regressor_.coef_)

    return run


def hankel_dmd(file: Path, delays: int, degree: int, snapshots: int) -> Callable[[], Spectrum]:
    """PyDMD's HankelDMD of the samples' monomials, which it lacks."""
    from pydmd import HankelDMD
    from sklearn.preprocessing import PolynomialFeatures

    def run() -> Spectrum:
        states = _embedded(file, delays, snapshots)
        lifted = PolynomialFeatures(degree).fit_transform(states.T).T
        return HankelDMD(svd_rank=-1, d=1).fit(lifted).eigs

    return run


def _embedded(file: Path, delays: int, snapshots: int) -> Any:
    samples = np.load(file)[: snapshots + delays]
    return np.lib.stride_tricks.sliding_window_view(samples, delays).T[::-1].copy()


def main(tool: str, file: Path, delays: int, degree: int, snapshots: int) -> None:
    """Measure one tool."""
    warnings.simplefilter("ignore")
    try:
        run = globals()[tool](file, delays, degree, snapshots)
    except ModuleNotFoundError as error:
        sys.exit(f"{error.name} is not installed: pip install pydmd pykoop, or choose --python")
    best, total = np.inf, 0.0
    for number in range(RUNS):
        before, begin = _peak(), time.process_time()
        eigenvalues = run()
        elapsed = time.process_time() - begin
        if not number:
            memory = _peak() - before
        best, total = min(best, elapsed), total + elapsed
        if total > LONG:
            break
    result = {
        "time": best,
        "memory": memory,
        "real": np.real(eigenvalues).tolist(),
        "imag": np.imag(eigenvalues).tolist(),
    }
    print(json.dumps(result))


def _peak() -> int:
    """Most memory that this process has held [B]."""
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) * 1024


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), *map(int, sys.argv[3:]))
