"""Run experiments to the end and put their sections together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from koop_study.experiments.kinds import Experiment
from koop_study.workers.cluster import Workers
from koop_study.workers.units import Store, Unit
from koop_view.report.document import Section


def run_all(
    experiments: Sequence[Experiment], store: Store, processes: int, scheduler: str = ""
) -> list[Section]:
    """Return one section an experiment, in their order.

    Experiments ask for units in stages; all that are at the same stage share the workers:
    ``processes`` of this machine, or those of the Dask scheduler at an address.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C; every result that was complete is in the store.
    koop_study.workers.cluster.WorkerLost
        If workers were killed again and again; so it is then.
    """
    sections: dict[int, Section] = {}
    steps = {i: experiment.steps() for i, experiment in enumerate(experiments)}
    asked: dict[int, list[Unit]] = {i: next(step) for i, step in steps.items()}
    with Workers(store, processes, scheduler) as workers:
        while asked:
            results = iter(workers.results([unit for wanted in asked.values() for unit in wanted]))
            following: dict[int, list[Unit]] = {}
            for i, wanted in asked.items():
                answer: list[Any] = [next(results) for _ in wanted]
                try:
                    following[i] = steps[i].send(answer)
                except StopIteration as stop:
                    sections[i] = stop.value
            asked = following
    return [sections[i] for i in range(len(experiments))]
