"""Run laws on plants and measure the runs; the functions of the worker processes."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from koop_core.config.parameter import ConfigError
from koop_loop.settings import METRICS
from koop_study.family.config import FamilyConfig, family_of
from koop_study.family.learning import learned_contrast
from koop_study.family.loop import RunNoise, close, noise_of
from koop_study.family.rig import Rig, draw
from koop_study.family.scaled import PAPER_OMEGA, PAPER_TIME, ScaledConstants, scaled_to
from koop_study.family.settings import FAMILY
from koop_study.simulation import run as paper
from koop_study.simulation.case import Case, case_of, override
from koopman_lifter.model import KoopmanModel

JUMP = 0.1  # change of theta* from one step to the next that is not a drift
COSTS_OF_RIGS = ("raw", "contrast")
LawRow = dict[str, Any]


@dataclass(frozen=True)
class LawPlant:
    """A plant with a cost, as an experiment file declares it.

    Attributes
    ----------
    name : str
        In the table.
    family : bool
        Whether each seed draws a rig; otherwise the paper's plant.
    cost : str
        On the family ``raw`` or ``contrast``, of a recording of the rig; on the paper's plant any.
    duration : float
        Of a run: seconds on the paper's plant, on the family multiples of the rig's time.
    settings : dict
        Of the paper's plant, as in the other experiments, or of the family.
    """

    name: str
    family: bool
    cost: str
    duration: float
    settings: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.family and self.cost not in COSTS_OF_RIGS:
            raise ConfigError(f"cost = {self.cost!r}: on the family raw or contrast")
        if not 0.0 < self.duration <= 1e6:
            raise ConfigError(f"duration = {self.duration:g}: must be above 0 and at most 1e6")

    def rigs(self) -> FamilyConfig:
        """Return the family."""
        return family_of(self.settings)

    def paper_settings(self, constants: ScaledConstants | None = None) -> dict[str, Any]:
        """Return the settings of the paper's loop with some constants."""
        settings: dict[str, Any] = {"cost": self.cost, "duration": self.duration, **self.settings}
        if constants is None:
            return settings
        esc = override(Case(), settings).esc
        lifter = constants.lifter(PAPER_OMEGA, PAPER_TIME)
        command = constants.esc(PAPER_TIME, esc.theta_max - esc.theta_min, esc.dt)
        return {
            **settings,
            **{f"lifter.{name}": value for name, value in lifter.items()},
            **{f"esc.{name}": value for name, value in command.items()},
        }


def law_runs(plant: dict[str, Any], constants: dict[str, Any], seeds: list[int]) -> list[LawRow]:
    """Return the figures of a law's run with each seed.

    Returns
    -------
    list of dict
        ``score``: on the paper's plant IAE; on a rig the rms amplitude over the second half of the
        run over that of the best fixed theta with the same noise (its inverse where the amplitude
        is to be maximised). ``failed``: 1 where the paper's tail error is above 0.6 or the rig's
        score above 1.5. ``reacquired``: on the paper's plant the time [s] after which theta is
        within 0.6 after each jump of the optimum; None where it is not before the next one.
    """
    return list(_rows(LawPlant(**plant), ScaledConstants(**constants), seeds))


def _rows(plant: LawPlant, constants: ScaledConstants, seeds: list[int]) -> Iterator[LawRow]:
    if plant.family:
        for seed in seeds:
            rig, model, noise = _drawn(json.dumps(asdict(plant), sort_keys=True), seed)
            ratio = close(rig, scaled_to(rig, constants, model), noise, seed).ratio
            yield {"score": ratio, "failed": float(ratio > FAMILY.good), "reacquired": []}
        return
    for seed in seeds:
        case = case_of(plant.paper_settings(constants), seed)
        yield paper_row(case, paper.run(case))


def paper_row(case: Case, trace: paper.Trace) -> LawRow:
    """Return the row of a run on the paper's plant."""
    metrics = paper.measure(case, trace)
    if trace.diverged:
        return {"score": math.inf, "failed": 1.0, "reacquired": []}
    displaced = paper.displacement(case.scenario, case.steps, case.plant.dt)
    reacquired = []
    if displaced.size:
        near = np.abs(trace.theta - displaced - case.plant.theta_star) <= METRICS.converged
        jumps = np.flatnonzero(np.abs(np.diff(displaced)) > JUMP) + 1
        for begin, end in itertools.pairwise(jumps):  # the last one is cut short
            inside = np.flatnonzero(near[begin:end])
            reacquired.append(float(inside[0] * case.plant.dt) if inside.size else None)
    failed = 1.0 - float(metrics["converged"] or 0.0)
    return {"score": metrics["iae"], "failed": failed, "reacquired": reacquired}


@lru_cache(maxsize=4)  # as many as a unit of work has: the next law's unit has the same ones
def _drawn(plant: str, seed: int) -> tuple[Rig, KoopmanModel | None, RunNoise]:
    """Return a rig, the model of its cost, and the noise of its runs."""
    config = LawPlant(**json.loads(plant))
    rig = draw(config.rigs(), seed)
    model = None if config.cost == "raw" else learned_contrast(json.dumps(config.settings), seed)
    return rig, model, noise_of(rig, round(config.duration * rig.time / rig.params.dt), seed)
