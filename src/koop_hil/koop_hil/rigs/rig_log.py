#!/usr/bin/env python3
"""A rig's own log, which the loop does not read: theta and the true state, every second.

What it says about a recording, to judge a verdict by:

    python rig.py absorber --scale 10 --log rig.csv
    python rig_log.py rig.csv mine/verify-1/start-1
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

PARTS = 10  # of a recording


class Log:
    """Writes a line for every second of the rig's time.

    Columns: time of the day [s], the rig's own time [s], mean of each knob, then mean and standard
    deviation of each number of the true state. The first line names those before these.
    """

    def __init__(self, path: str, dt: float, knobs: Sequence[str]) -> None:
        self._file = Path(path).open("w", buffering=1)  # noqa: SIM115  open to the end, by lines
        self._file.write("#clock,time," + ",".join(knobs) + "\n")
        self._count, self._knobs = round(1.0 / dt), len(knobs)
        self._samples: list[tuple[float, ...]] = []

    def add(self, t: float, theta: Sequence[float], truth: Sequence[float]) -> None:
        """Take a sample."""
        self._samples.append((*theta, *truth))
        if len(self._samples) < self._count:
            return
        samples = np.array(self._samples)
        moments = np.stack([samples.mean(axis=0), samples.std(axis=0)], axis=1)
        values = [*moments[: self._knobs, 0], *moments[self._knobs :].ravel()]
        self._samples.clear()
        self._file.write(f"{time.time():.3f},{t:.3f}")
        self._file.write("".join(f",{value:.6g}" for value in values) + "\n")


def amplitudes(moments: np.ndarray) -> np.ndarray:
    """Return the true amplitudes over lines of moments: sqrt(2) times the standard deviations."""
    means, spreads = moments[:, ::2], moments[:, 1::2]
    return np.sqrt(2.0 * ((spreads**2).mean(axis=0) + means.var(axis=0)))


def during(lines: np.ndarray, folder: Path) -> np.ndarray:
    """Return the lines of the time of a recording; raise ValueError if the log has none."""
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
    with open(args.log) as file:
        _, _, *knobs = file.readline().split(",")
    for folder in args.folders:
        head = "         theta      " * len(knobs)
        print(f"{folder}\n   until [s]{head}    true amplitude")
        for part in np.array_split(during(lines, folder), PARTS):
            theta, moments = np.split(part[:, 2:], [len(knobs)], axis=1)
            row = "".join(f"{v.min():10.4g} to{v.max():7.4g}  " for v in theta.T)
            print(f"{part[-1, 1]:12.5g}{row}", *(f"{v:9.4g}" for v in amplitudes(moments)))


if __name__ == "__main__":
    main()
