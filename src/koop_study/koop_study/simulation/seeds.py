"""Run the cases of several seeds: side by side where the nodes' relay answers every state.

Cases of one setting have the plant's damping and forcing in common, its controller and what moves
the optimum; their models, the interference's phases and the noise are their own.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from koop_loop.batch import NOTHING_ADDED, STATES, run_batch, side_by_side
from koop_study.simulation.case import Case, model_of
from koop_study.simulation.run import Trace, lifter_of, run
from koop_study.simulation.scenario import expose
from vdp_plant.waves import LONGEST

TOGETHER = 16  # loops whose signals a process holds at a time: 0.4 GB of 2500 s


def run_seeds(cases: Sequence[Case]) -> Iterator[Trace]:
    """Run cases that differ in their seeds only, each to the last bit as :func:`run` does it.

    Raises
    ------
    koop_node.config.ConfigError
        If the parts of a case do not fit together.
    """
    for first in range(0, len(cases), TOGETHER):
        some = cases[first : first + TOGETHER]
        yield from together(some) if is_plain(some[0]) else map(run, some)


def is_plain(case: Case) -> bool:
    """Return whether ``koop_loop.batch`` has all that the case needs."""
    return (
        case.controller == "relay"
        and case.cost != "log"
        and case.scenario.lost == 0.0
        and case.sensing.indices.size == STATES
        and case.steps <= LONGEST
    )


def together(cases: Sequence[Case]) -> Iterable[Trace]:
    """Run cases of :func:`is_plain`."""
    plants, models = [case.plant for case in cases], [model_of(case) for case in cases]
    lifters = [lifter_of(case, model) for case, model in zip(cases, models, strict=True)]
    if not side_by_side(plants, models):
        return map(run, cases)
    exposures = [expose(case.scenario, case.plant, case.steps, case.plant.seed) for case in cases]
    steps, added = cases[0].steps, exposures[0].added.size > 0
    r, theta, finite = run_batch(
        plants,
        lifters[0],
        cases[0].esc,
        models,
        steps,
        np.array([exposure.waves.interference for exposure in exposures]),
        np.array([exposure.added for exposure in exposures]) if added else NOTHING_ADDED,
        exposures[0].displaced,
    )
    t, no_truth = np.arange(steps, dtype=np.float64) * cases[0].plant.dt, np.empty((0, 2))
    return (
        Trace(t, r[i], theta[i], no_truth, steps) if finite[i] else run(case)
        for i, case in enumerate(cases)
    )
