"""Work on units with all cores: resumable, interruptible, with progress."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any

from tqdm import tqdm

from koop_study.simulation.work import WORK, runs
from koop_study.workers.units import Store, Unit

# One thread a process: the cores are taken by processes, and a sum whose order does not depend on
# the number of threads gives the same bytes on a second run.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class WorkerLost(RuntimeError):
    """A worker process ended in the middle of its work."""


def work_on(units: Sequence[Unit], store: Store, processes: int) -> list[Any]:
    """Return the results of all units in their order; what the store has is not computed again.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C; every result that was complete is in the store.
    WorkerLost
        If a worker process was killed; every result that was complete is in the store.
    """
    pending = list({unit.key: unit for unit in units if not store.has(unit)}.values())
    if pending:
        known = len(units) - len(pending)
        print(f"{len(units)} units of work, {known} of them there already", file=sys.stderr)
        with _one_thread_each():
            _compute(pending, store, processes)
    return [store.load(unit) for unit in units]


@contextmanager
def _one_thread_each() -> Iterator[None]:
    saved = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in saved.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _compute(pending: list[Unit], store: Store, processes: int) -> None:
    runs({"duration": 1.0, "training.trajectories": 2, "training.duration": 2.0}, [0])  # compiles
    executor = ProcessPoolExecutor(
        min(processes, len(pending)), multiprocessing.get_context("spawn"), _begin
    )
    lost = False
    try:
        futures = [executor.submit(_do, unit) for unit in pending]
        with tqdm(total=len(pending), unit="unit", smoothing=0.0, disable=None) as bar:
            for future in as_completed(futures):
                if isinstance(future.exception(), BrokenProcessPool):
                    lost = True
                    continue
                store.save(*future.result())
                bar.update()
    except BaseException:
        for process in multiprocessing.active_children():
            process.terminate()
        raise
    finally:
        executor.shutdown(cancel_futures=True)
    if lost:
        raise WorkerLost(
            "a worker process was killed, perhaps for want of memory; the results so far are kept, "
            "and the same command goes on from them (with fewer --processes, it needs less memory)"
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
