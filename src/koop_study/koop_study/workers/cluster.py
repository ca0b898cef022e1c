"""Work on units with Dask, on this machine or on a cluster: resumable, with progress."""

from __future__ import annotations

import concurrent.futures
import importlib.util
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
from koop_study.simulation.work import runs
from koop_study.workers.units import Store, Unit

if TYPE_CHECKING:
    import distributed

DASHBOARD = "127.0.0.1:8787"  # Dask's usual port; another one where it is taken
NO_DASHBOARD = "127.0.0.1:0"
PATIENCE = 10.0  # for an answer of the scheduler [s]
KEPT = dict.fromkeys(("MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_"), str(1 << 30))
"""A worker's signals come and go by megabytes: freed memory is used again, not returned."""


class WorkerLost(RuntimeError):
    """Workers ended in the middle of their work, again and again."""


class Workers:
    """Processes that compute units; a context manager, after which none of its own is left.

    Parameters
    ----------
    store : Store
        Results that it has are not computed again; every new one is saved at once.
    processes : int
        At work at the same time on this machine; they start when there is something to compute.
        One that is killed is started again, and another one takes its unit.
    scheduler : str
        Address of a Dask scheduler whose workers compute in place of processes of this machine.
    """

    def __init__(self, store: Store, processes: int, scheduler: str = "") -> None:
        self._store, self._processes, self._scheduler = store, processes, scheduler
        self._stack = ExitStack()
        self._client: distributed.Client | None = None

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *error: Any) -> None:
        self._client = None
        self._stack.__exit__(*error)

    def results(self, units: Sequence[Unit]) -> list[Any]:
        """Return the results of all units in their order.

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
        pending = list({u.key: u for u in units if not self._store.has(u)}.values())
        if pending:
            known = len(units) - len(pending)
            print(f"{len(units)} units of work, {known} of them there already", file=sys.stderr)
            self._compute(pending)
        return [self._store.load(unit) for unit in units]

    def _compute(self, pending: list[Unit]) -> None:
        if self._client is None:
            self._client = self._stack.enter_context(
                on_cluster(self._scheduler) if self._scheduler else on_this_machine(self._processes)
            )
        from distributed import KilledWorker, as_completed
        from distributed.comm import CommClosedError

        from koop_study.workers.task import compute

        # named by content: the scheduler computes a unit once, even for two studies
        name_of = {f"{unit.work}-{unit.key}": unit for unit in pending}
        futures = self._client.map(
            compute,
            [unit.work for unit in pending],
            [unit.arguments for unit in pending],
            [unit.key for unit in pending],
            key=list(name_of),
        )
        lost = ""
        with tqdm(total=len(pending), unit="unit", smoothing=0.0, disable=None) as bar:
            arriving = as_completed(futures, loop=self._client.loop)
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
                self._store.save(name_of[future.key], result)
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
    client, cluster = _dask()
    import dask

    from koop_study.workers.task import THREADS

    # compiles, so that the processes need not
    runs({"duration": 1.0, "training.trajectories": 2, "training.duration": 2.0}, [0])
    dashboard = importlib.util.find_spec("bokeh") is not None
    with ExitStack() as stack:
        environment = dict.fromkeys(THREADS, "1") | KEPT
        stack.enter_context(dask.config.set({"distributed.nanny.pre-spawn-environ": environment}))
        with _without_interrupt():
            local = stack.enter_context(
                cluster(
                    n_workers=processes,
                    threads_per_worker=1,
                    memory_limit=0,
                    dashboard_address=DASHBOARD if dashboard else NO_DASHBOARD,
                )
            )
        if dashboard:
            print(f"dashboard: {local.dashboard_link}", file=sys.stderr)
        connected = stack.enter_context(client(local, set_as_default=False))
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
    """Connect to a scheduler.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If none answers.
    """
    client, _ = _dask()
    # of a scheduler that has gone it would write tracebacks
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    try:
        connected = client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ConfigError(f"--scheduler {address}: no Dask scheduler there ({error})") from None
    with connected:
        print(f"dashboard: {connected.dashboard_link}", file=sys.stderr)
        if not connected.scheduler_info()["workers"]:
            print(
                f"{address} has no worker yet; start some: dask worker {address} --nthreads 1",
                file=sys.stderr,
            )
        yield connected


def _dask() -> tuple[type[distributed.Client], type[distributed.LocalCluster]]:
    """Import Dask, which takes a second that a study with nothing to compute need not wait."""
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise ConfigError(
            f"the study computes with Dask ({error}): pip install dask distributed"
        ) from None
    return Client, LocalCluster


@contextmanager
def _without_interrupt() -> Iterator[None]:
    """Leave Ctrl-C to this thread: threads and processes that begin in here never get it."""
    multiprocessing.resource_tracker.ensure_running()  # which would unblock it in whoever starts it
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
