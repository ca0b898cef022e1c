"""Run experiments to the end and put their sections together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from koop_study.experiments.kinds import Experiment
from koop_study.report.document import Section
from koop_study.workers.pool import work_on
from koop_study.workers.units import Store, Unit


def run_all(experiments: Sequence[Experiment], store: Store, processes: int) -> list[Section]:
    """Return one section an experiment, in their order.

    Experiments ask for units in stages; all that are at the same stage share the processes.
    """
    sections: dict[int, Section] = {}
    steps = {i: experiment.steps() for i, experiment in enumerate(experiments)}
    asked: dict[int, list[Unit]] = {i: next(step) for i, step in steps.items()}
    while asked:
        units = [unit for wanted in asked.values() for unit in wanted]
        results = iter(work_on(units, store, processes))
        following: dict[int, list[Unit]] = {}
        for i, wanted in asked.items():
            answer: list[Any] = [next(results) for _ in wanted]
            try:
                following[i] = steps[i].send(answer)
            except StopIteration as stop:
                sections[i] = stop.value
        asked = following
    return [sections[i] for i in range(len(experiments))]
