"""Work on units with all cores: resumable, interruptible, with progress."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Sequence
from typing import Any

from koop_study.simulation.work import WORK, runs
from koop_study.workers.units import Store, Unit

# One thread a process: the cores are taken by processes, and a sum whose order does not depend on
# the number of threads gives the same bytes on a second run.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def work_on(units: Sequence[Unit], store: Store, processes: int) -> list[Any]:
    """Return the results of all units in their order; what the store has is not computed again.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C; every result that was complete is in the store.
    """
    pending = list({unit.key: unit for unit in units if not store.has(unit)}.values())
    if pending:
        saved = {name: os.environ.get(name) for name in THREADS}
        os.environ.update(dict.fromkeys(THREADS, "1"))
        try:
            _compute(pending, store, len(units) - len(pending), processes)
        finally:
            for name, value in saved.items():
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value
    return [store.load(unit) for unit in units]


def _compute(pending: list[Unit], store: Store, known: int, processes: int) -> None:
    runs({"duration": 1.0, "training.trajectories": 2, "training.duration": 2.0}, [0])  # compiles
    progress = Progress(len(pending), known)
    context = multiprocessing.get_context("spawn")
    pool = context.Pool(min(processes, len(pending)), _begin)
    try:
        for unit, result in pool.imap_unordered(_do, pending):
            store.save(unit, result)
            progress.advance()
        pool.close()
    except BaseException:
        pool.terminate()
        raise
    finally:
        pool.join()
        progress.end()


def _begin() -> None:
    """Leave Ctrl-C to the parent process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _do(unit: Unit) -> tuple[Unit, Any]:
    return unit, WORK[unit.work](**unit.arguments)


class Progress:
    """A line on stderr: units done, share, time left. On no terminal, a line every 10 %."""

    def __init__(self, total: int, known: int) -> None:
        self.total, self.known, self.done = total, known, 0
        self.begin = time.monotonic()
        self.terminal = sys.stderr.isatty()

    def advance(self) -> None:
        """Count one unit."""
        self.done += 1
        left = (time.monotonic() - self.begin) / self.done * (self.total - self.done)
        kept = f", {self.known} kept from before" if self.known else ""
        line = f"{self.done}/{self.total} units{kept}, about {left:.0f} s left"
        if self.terminal:
            print(f"\r\x1b[K{line}", end="", file=sys.stderr, flush=True)
        elif self.done * 10 // self.total > (self.done - 1) * 10 // self.total:
            print(line, file=sys.stderr, flush=True)

    def end(self) -> None:
        """Close the line."""
        if self.terminal and self.done:
            print(file=sys.stderr)
