"""Run experiments to the end and put their sections together."""

from __future__ import annotations

from collections.abc import Sequence

from koop_study.experiments.kinds import Experiment
from koop_study.workers.cluster import Workers
from koop_study.workers.units import Store
from koop_view.report.document import Section


def run_all(
    experiments: Sequence[Experiment], store: Store, processes: int, scheduler: str = ""
) -> list[Section]:
    """Return one section an experiment, in their order.

    All units share the workers: ``processes`` of this machine, or those of the Dask scheduler at an
    address.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C; every result that was complete is in the store.
    koop_study.workers.cluster.WorkerLost
        If workers were killed again and again; the same holds then.
    """
    units = [experiment.units() for experiment in experiments]
    with Workers(store, processes, scheduler) as workers:
        results = iter(workers.results([unit for some in units for unit in some]))
    return [
        experiment.section([next(results) for _ in some])
        for experiment, some in zip(experiments, units, strict=True)
    ]
