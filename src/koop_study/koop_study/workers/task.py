"""One unit of work on a worker, on this machine or another one."""

from __future__ import annotations

from pkgutil import resolve_name
from typing import Any

import distributed

from koop_study.workers.units import Unit

# imported when it is done: one work's imports are not another's
SIMULATION = "koop_study.simulation.work"
WORK = {
    **{name: f"{SIMULATION}:{name}" for name in ("runs", "modes", "ramp", "settled", "trace")},
    **{name: f"koop_study.simulation.knobs:{name}" for name in ("knobs_of_map", "knobs_of_plant")},
    "seek_yardstick": "koop_study.simulation.yardsticks:seek_yardstick",
    "commission_plant": "koop_study.commissioning.work:commission_plant",
    "commission_knobs": "koop_study.commissioning.knobs:commission_knobs",
}


class UnfitWorker(ValueError):
    """A worker whose results would differ from another worker's."""


def compute(work: str, arguments: dict[str, Any], key: str) -> Any:
    """Return the result of a unit.

    Raises
    ------
    UnfitWorker
        If the key is another one here, as other code decides the result, or if the worker has
        more than one thread, on whose number the order of sums and so the last bits depend.
    """
    worker = distributed.get_worker()
    if Unit(work, arguments).key != key:
        raise UnfitWorker(
            f"the worker {worker.address} has other code, or another version of NumPy, SciPy or "
            "Numba: set it up from the same commit"
        )
    if worker.state.nthreads != 1:
        raise UnfitWorker(f"the worker {worker.address} has several threads: --nthreads 1")
    return resolve_name(WORK[work])(**arguments)
