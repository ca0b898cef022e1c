"""Run the cases of several seeds: side by side where the controller answers every state.

Cases of one setting have the plant's damping and forcing in common, its controller and what moves
the optimum; their models, the interference's phases and the noise are their own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from koop_loop.batch import STATES, run_batch
from koop_study.simulation.case import Case, model_of
from koop_study.simulation.run import Trace, lifter_of, run
from koop_study.simulation.scenario import expose
from koopman_lifter.model import KoopmanModel
from vdp_plant.dynamics import RK4
from vdp_plant.waves import LONGEST

TOGETHER = 16  # loops whose signals a process holds at a time: 0.4 GB of 2500 s


def run_seeds(cases: Sequence[Case]) -> Iterator[Trace]:
    """Run cases that differ in their seeds only, each to the last bit as :func:`run` does it.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If the parts of a case do not fit together.
    """
    for first in range(0, len(cases), TOGETHER):
        some = cases[first : first + TOGETHER]
        yield from side_by_side(some) if is_plain(some[0]) else map(run, some)


def is_plain(case: Case) -> bool:
    """Return whether ``koop_loop.batch`` has all that the case needs."""
    return (
        case.scenario.lost == 0.0
        and case.sensing.indices.size == STATES
        and case.sensing.delays == 1
        and case.plant.params().integrator == RK4
        and case.steps <= LONGEST
    )


def side_by_side(cases: Sequence[Case]) -> list[Trace]:
    """Run cases of :func:`is_plain`; those whose models have as many modes take steps together."""
    models = [model_of(case) for case in cases]
    groups: dict[object, list[int]] = {}
    for i, model in enumerate(models):
        groups.setdefault(None if model is None else model.projector.shape, []).append(i)
    traces: dict[int, Trace] = {}
    for members in groups.values():
        found = together([cases[i] for i in members], [models[i] for i in members])
        traces.update(zip(members, found, strict=True))
    return [traces[i] for i in range(len(cases))]


def together(cases: Sequence[Case], models: Sequence[KoopmanModel | None]) -> Iterator[Trace]:
    """Run cases whose models have projectors of one shape."""
    one, lifter = cases[0], lifter_of(cases[0], models[0])
    exposures = [expose(case.scenario, case.plant, case.steps, case.plant.seed) for case in cases]
    r, theta, finite = run_batch(
        [case.plant for case in cases],
        lifter,
        one.esc,
        models,
        one.steps,
        np.array([exposure.waves.interference for exposure in exposures]),
        np.array([exposure.added for exposure in exposures]),
        exposures[0].displaced,
        exposures[0].waves.drive,
    )
    t, nothing = np.arange(one.steps, dtype=np.float64) * one.plant.dt, np.empty(0)
    for i in range(len(cases)):
        cost, command = (r[i], theta[i]) if finite[i] else (nothing, nothing)
        yield Trace(t, cost, command, np.empty((0, 2)))
