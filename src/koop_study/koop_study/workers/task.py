"""One unit of work on a worker, on this machine or another one."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import distributed

from koop_study.laws import run
from koop_study.simulation import work as paper
from koop_study.workers.units import COMMISSION, Unit

# One thread a process: the cores are taken by processes, and a sum whose order does not depend on
# the number of threads gives the same bytes on a second run.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def commission_plant(**arguments: Any) -> Any:
    """Do :func:`koop_study.commissioning.work.commission_plant`, which no other work imports."""
    from koop_study.commissioning.work import commission_plant as commission

    return commission(**arguments)


WORK: dict[str, Callable[..., Any]] = {
    **paper.WORK,
    **run.WORK,
    COMMISSION: commission_plant,
}


class UnfitWorker(ValueError):
    """A worker whose results would differ from another worker's."""


def compute(work: str, arguments: dict[str, Any], key: str) -> Any:
    """Return the result of a unit.

    Raises
    ------
    UnfitWorker
        If the key is another one here, as other code decides the result, or if the worker has
        more than one thread.
    """
    worker = distributed.get_worker()
    if Unit(work, arguments).key != key:
        raise UnfitWorker(
            f"the worker {worker.address} has other code, or another version of NumPy, SciPy or "
            "Numba: set it up from the same commit"
        )
    _check_threads(worker.address, worker.state.nthreads)
    return WORK[work](**arguments)


@lru_cache(maxsize=1)
def _check_threads(address: str, threads: int) -> None:
    if threads != 1 or any(os.environ.get(name, "1") != "1" for name in THREADS):
        raise UnfitWorker(
            f"the worker {address} has several threads: start it with --nthreads 1 and without "
            f"{', '.join(THREADS)} in its environment"
        )
