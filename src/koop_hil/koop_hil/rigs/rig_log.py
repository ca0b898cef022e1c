#!/usr/bin/env python3
"""A rig's own log, which the loop does not read: theta and the true state, every second.

What it says about a recording, to judge a verdict by:

    python rig.py absorber --scale 10 --log rig.csv
    python rig_log.py rig.csv mine/verify-1/start-1
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import yaml

PARTS = 10  # of a recording


class Log:
    """Writes a line for every second of the rig's time.

    Columns: time of the day [s], the rig's own time [s], mean of theta, then mean and standard
    deviation of each number of the true state.
    """

    def __init__(self, path: str, dt: float, clock: Callable[[], float] = time.time) -> None:
        self._file = Path(path).open("w", buffering=1)  # noqa: SIM115  open to the end, by lines
        self._count, self._clock = round(1.0 / dt), clock
        self._samples: list[tuple[float, ...]] = []

    def add(self, t: float, theta: float, truth: Sequence[float]) -> None:
        """Take a sample."""
        self._samples.append((theta, *truth))
        if len(self._samples) < self._count:
            return
        samples = np.array(self._samples)
        moments = np.stack([samples.mean(axis=0), samples.std(axis=0)], axis=1).ravel()
        self._samples.clear()
        self._file.write(f"{self._clock():.3f},{t:.3f},{moments[0]:.6g}")
        self._file.write("".join(f",{value:.6g}" for value in moments[2:]) + "\n")


def amplitudes(lines: np.ndarray) -> np.ndarray:
    """Return the true amplitudes over lines of a log: sqrt(2) times the standard deviations."""
    means, spreads = lines[:, 3::2], lines[:, 4::2]
    return np.sqrt(2.0 * ((spreads**2).mean(axis=0) + means.var(axis=0)))


def during(lines: np.ndarray, folder: Path) -> np.ndarray:
    """Return the lines of the time of a recording.

    Raises
    ------
    ValueError
        If the log has none.
    """
    metadata = yaml.safe_load((folder / "bag" / "metadata.yaml").read_text())
    bag = metadata["rosbag2_bagfile_information"]
    clock = lines[:, 0] - 1e-9 * bag["starting_time"]["nanoseconds_since_epoch"]
    rows = lines[(clock >= 0.0) & (clock <= 1e-9 * bag["duration"]["nanoseconds"])]
    if not len(rows):
        raise ValueError(f"the log has nothing of the time of {folder}")
    return rows


def main(words: Sequence[str] | None = None) -> None:
    """Print theta and true amplitude in the course of recordings, each in ten parts."""
    parser = argparse.ArgumentParser(prog="rig_log.py", description=main.__doc__)
    parser.add_argument("log", metavar="LOG.CSV")
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER", help="with a bag")
    args = parser.parse_args(words)
    lines = np.loadtxt(args.log, delimiter=",", ndmin=2)
    for folder in args.folders:
        print(f"{folder}\n   until [s]         theta          true amplitude")
        for part in np.array_split(during(lines, folder), PARTS):
            theta, true = part[:, 2], amplitudes(part)
            row = f"{part[-1, 1]:12.5g}{theta.min():10.4g} to{theta.max():7.4g}  "
            print(row, *(f"{value:9.4g}" for value in true))


if __name__ == "__main__":
    main()
