"""Work on units with all cores: resumable, interruptible, with progress."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from tqdm import tqdm

from koop_study.simulation.work import runs
from koop_study.workers.registry import WORK
from koop_study.workers.units import Store, Unit

# One thread a process: the cores are taken by processes, and a sum whose order does not depend on
# the number of threads gives the same bytes on a second run.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class WorkerLost(RuntimeError):
    """A worker process ended in the middle of its work."""


class Workers:
    """Processes that compute units; a context manager, after which none of them is left.

    Parameters
    ----------
    store : Store
        What it has is not computed again; every new result is in it at once.
    processes : int
        At work at the same time; they start when there is something to compute.
    """

    def __init__(self, store: Store, processes: int) -> None:
        self._store, self._processes = store, processes
        self._executor: ProcessPoolExecutor | None = None
        self._environment = dict(os.environ)

    def __enter__(self) -> Workers:
        os.environ.update(dict.fromkeys(THREADS, "1"))
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        for name in THREADS:
            os.environ.pop(name)
            if name in self._environment:
                os.environ[name] = self._environment[name]
        if self._executor is not None:
            if kind is not None:  # Ctrl-C, or a unit that failed: nobody waits for the others
                for process in multiprocessing.active_children():
                    process.terminate()
            self._executor.shutdown(cancel_futures=True)

    def results(self, units: Sequence[Unit]) -> list[Any]:
        """Return the results of all units in their order.

        Raises
        ------
        WorkerLost
            If a worker process was killed; every result that was complete is in the store.
        """
        pending = list({u.key: u for u in units if not self._store.has(u)}.values())
        if pending:
            known = len(units) - len(pending)
            print(f"{len(units)} units of work, {known} of them there already", file=sys.stderr)
            self._compute(pending)
        return [self._store.load(unit) for unit in units]

    def _compute(self, pending: list[Unit]) -> None:
        if self._executor is None:
            # compiles, so that the processes need not
            runs({"duration": 1.0, "training.trajectories": 2, "training.duration": 2.0}, [0])
            context = multiprocessing.get_context("spawn")
            self._executor = ProcessPoolExecutor(self._processes, context, _begin)
        futures = [self._executor.submit(_do, unit) for unit in pending]
        lost = False
        with tqdm(total=len(pending), unit="unit", smoothing=0.0, disable=None) as bar:
            for future in as_completed(futures):
                if isinstance(future.exception(), BrokenProcessPool):
                    lost = True
                    continue
                self._store.save(*future.result())
                bar.update()
        if lost:
            raise WorkerLost(
                "a worker process was killed, perhaps for want of memory; the results so far are "
                "kept, and the same command goes on from them (with fewer --processes, it needs "
                "less memory)"
            )


def _begin() -> None:
    """Leave Ctrl-C to the parent process, and end when it has ended, however it did."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _do(unit: Unit) -> tuple[Unit, Any]:
    return unit, WORK[unit.work](**unit.arguments)
