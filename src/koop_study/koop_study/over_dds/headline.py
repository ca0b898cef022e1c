"""The headline runs, and whether a recorded run is the same run.

A headline run is a case that the nodes can run as it is: the paper's plant and relay, and a cost
that is a model file. :func:`headlines` gives configurations and model for a run over DDS in
lockstep; :func:`compare` holds what was recorded against the offline loop, bit for bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.column_diff import column_diff
from koop_core.errors import InputError
from koop_loop.loop import LoopResult, simulate
from koop_study.experiments.closed_loop import ClosedLoopConfig
from koop_study.simulation.case import Case, model_of
from koop_study.simulation.work import case_of
from koopman_lifter.config import LifterConfig
from koopman_lifter.model import KoopmanModel
from relay_esc.config import EscConfig
from vdp_plant.config import PlantConfig


@dataclass(frozen=True)
class Headline:
    """What the three nodes need for one run.

    Attributes
    ----------
    name : str
        Row of the report's closed-loop table.
    plant, lifter, esc
        The nodes' configurations; ``plant.seed`` draws the initial state.
    model : KoopmanModel or None
        For the lifter's model file; None for the raw cost.
    steps : int
        Length of the run.
    """

    name: str
    plant: PlantConfig
    lifter: LifterConfig
    esc: EscConfig
    model: KoopmanModel | None
    steps: int

    def offline(self) -> LoopResult:
        """Return the run of the offline loop."""
        return simulate(self.plant, self.lifter, self.esc, self.model, self.steps)


def headlines(config: ClosedLoopConfig) -> list[Headline]:
    """Return the runs of the report's closed-loop table, in its order."""
    return [
        headline(name, case_of({**config.settings, **settings}, None))
        for name, settings in config.costs.items()
    ]


def headline(name: str, case: Case) -> Headline:
    """Return a case as configurations of the nodes.

    Raises
    ------
    ValueError
        If the nodes have no such disturbance.
    """
    if case.scenario != Case().scenario:
        raise InputError(
            f"the nodes cannot run '{name}': it needs more than plant, lifter and relay"
        )
    model = model_of(case)
    lifter = replace(case.lifter, cost="raw" if model is None else "lifted")
    return Headline(name, case.plant, lifter, case.esc, model, case.steps)


@dataclass(frozen=True)
class Difference:
    """Where two runs differ in one column.

    Attributes
    ----------
    column : str
        ``measured``, ``r`` or ``theta``, or ``step`` if steps are missing or out of order.
    first_step : int
        First step that differs.
    count : int
        Rows that differ.
    largest : float
        Largest absolute difference; NaN where a value is missing.
    """

    column: str
    first_step: int
    count: int
    largest: float


def compare(
    offline: LoopResult, recorded: Mapping[str, NDArray[np.float64] | NDArray[np.int64]]
) -> list[Difference]:
    """Compare a recorded run with the offline loop.

    Parameters
    ----------
    offline : LoopResult
        The run it should be.
    recorded : mapping
        Columns of the bag by name: ``step``, shape (M,); ``measured``, shape (M, 2); ``r`` and
        ``theta``, shape (M,). Row i belongs to step ``step[i]``.

    Returns
    -------
    list of Difference
        Empty if every step is there and every value equals the offline one to the last bit.
    """
    step = np.asarray(recorded["step"])
    expected = offline.step
    if step.size != expected.size or not np.array_equal(step, expected):
        shared = min(step.size, expected.size)
        wrong = np.flatnonzero(step[:shared] != expected[:shared])
        first = int(wrong[0]) if wrong.size else shared
        missing = int(np.setdiff1d(expected, step).size)
        return [Difference("step", first, max(missing, wrong.size), float("nan"))]
    found = []
    for column in ("measured", "r", "theta"):
        ours = np.asarray(getattr(offline, column)).reshape(expected.size, -1)
        theirs = np.asarray(recorded[column], dtype=np.float64).reshape(expected.size, -1)
        difference = column_diff(ours, theirs, bitwise=True)
        if difference is not None:
            found.append(Difference(column, difference.first, difference.count, difference.largest))
    return found
