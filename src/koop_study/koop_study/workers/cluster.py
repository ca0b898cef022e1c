"""Work on units with Dask, on this machine or on a cluster: resumable, with progress."""

from __future__ import annotations

import concurrent.futures
import logging
import multiprocessing.resource_tracker
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from koop_core.config.parameter import ConfigError
from koop_core.errors import KoopError
from koop_study.workers.units import Store, Unit

if TYPE_CHECKING:
    import distributed

PATIENCE = 10.0  # for an answer of the scheduler [s]
# a worker's signals come and go by megabytes: freed memory is used again, not returned
KEPT = {
    f"distributed.nanny.pre-spawn-environ.{name}": str(1 << 30)
    for name in ("MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_")
}


class WorkerLost(KoopError):
    """Workers ended in the middle of their work, again and again."""


def compute_all(
    units: Sequence[Unit], store: Store, processes: int, scheduler: str = ""
) -> list[Any]:
    """Return the results of all units in their order.

    Parameters
    ----------
    units : sequence of Unit
        Those that the store has are not computed again; every new result is saved at once.
    store : Store
        Store of the results.
    processes : int
        At work at the same time on this machine. One that is killed is started again, and another
        one takes its unit.
    scheduler : str
        Address of a Dask scheduler whose workers compute in place of processes of this machine.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If Dask is missing, or there is no scheduler at its address.
    koop_study.workers.task.UnfitWorker
        If a worker would compute something else.
    WorkerLost
        If the workers that had a unit were killed one after the other, or the scheduler; every
        result that was complete is in the store.
    """
    pending = list({u.key: u for u in units if not store.has(u)}.values())
    if pending:
        stored = len(units) - len(pending)
        print(f"{len(units)} units of work, {stored} of them there already", file=sys.stderr)
        try:
            import distributed  # noqa: F401  a second that others need not wait
        except ImportError as error:
            raise ConfigError(
                f"the study computes with Dask ({error}): pip install dask distributed"
            ) from None
        with on_cluster(scheduler) if scheduler else on_this_machine(processes) as client:
            _compute(client, pending, store)
    return [store.load(unit) for unit in units]


def _compute(client: distributed.Client, pending: list[Unit], store: Store) -> None:
    from distributed import KilledWorker, as_completed
    from distributed.comm import CommClosedError

    from koop_study.workers.task import compute

    # named by content: the scheduler computes a unit once, even for two studies
    name_of = {f"{unit.work}-{unit.key}": unit for unit in pending}
    works, arguments, keys = zip(*((u.work, u.arguments, u.key) for u in pending), strict=True)
    futures = client.map(compute, works, arguments, keys, key=list(name_of))
    lost = ""
    with tqdm(total=len(pending), unit="unit", smoothing=0.0, disable=None) as bar:
        arriving = as_completed(futures, loop=client.loop)
        del futures  # no worker need keep or repeat what is in the store
        for future in arriving:
            try:
                result = future.result()
            except KilledWorker:
                lost = "workers were killed: too little memory for so many --processes?"
                continue
            except (concurrent.futures.CancelledError, CommClosedError):
                lost = "the scheduler has gone"
                continue
            store.save(name_of[future.key], result)
            bar.update()
    if lost:
        raise WorkerLost(
            f"{lost}; the results so far are kept, and the same command resumes from them"
        )


@contextmanager
def on_this_machine(processes: int) -> Iterator[distributed.Client]:
    """Start a scheduler in this process, and workers as processes, all on the loopback address.

    They end with this process, however it ends: each watches a pipe to it.
    """
    import dask
    from distributed import Client, LocalCluster

    from koop_study.simulation.work import runs

    # compiles, so that the processes need not
    runs({"duration": 1.0, "training.trajectories": 2, "training.duration": 2.0}, [0])
    options = {"threads_per_worker": 1, "memory_limit": 0, "dashboard_address": None}
    with ExitStack() as stack:
        stack.enter_context(dask.config.set(KEPT))
        with _without_interrupt():
            local = stack.enter_context(LocalCluster(n_workers=processes, **options))
        connected = stack.enter_context(Client(local, set_as_default=False))
        try:
            yield connected
        finally:  # workers keep nothing: nobody waits for them, nor for a unit after Ctrl-C
            for nanny in local.workers.values():
                nanny.auto_restart = False
                if nanny.pid is not None:
                    with suppress(ProcessLookupError):  # killed, and its nanny doesn't know yet
                        os.kill(nanny.pid, signal.SIGKILL)


@contextmanager
def on_cluster(address: str) -> Iterator[distributed.Client]:
    """Connect to a scheduler; raise ConfigError if none answers within PATIENCE."""
    from distributed import Client

    # of a scheduler that has gone it would write tracebacks
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    try:
        connected = Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ConfigError(f"--scheduler {address}: no Dask scheduler there ({error})") from None
    with connected:
        if not connected.scheduler_info()["workers"]:
            start = f"dask worker {address} --nthreads 1"
            print(f"{address} has no worker yet; start some: {start}", file=sys.stderr)
        yield connected


@contextmanager
def _without_interrupt() -> Iterator[None]:
    """Leave Ctrl-C to this thread: threads and processes that begin in here never get it."""
    multiprocessing.resource_tracker.ensure_running()  # which would unblock it in whoever starts it
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
