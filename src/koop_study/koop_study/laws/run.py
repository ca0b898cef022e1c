"""Run laws on plants and measure the runs; the functions of the worker processes."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import ConfigError
from koop_core.kernels import njit
from koop_loop.metrics import CONVERGED, TAIL
from koop_study.family import oscillator
from koop_study.family.config import FamilyConfig, family_of
from koop_study.family.learning import learned_contrast
from koop_study.family.loop import GOOD, RunNoise, close, noise_of
from koop_study.family.oscillator import RigParams
from koop_study.family.rig import Rig, draw
from koop_study.family.scaled import PAPER_OMEGA, PAPER_TIME, ScaledConstants, scaled_to
from koop_study.simulation import run as paper
from koop_study.simulation.case import Case, override
from koop_study.simulation.scenario import displacement
from koop_study.simulation.work import case_of
from koopman_lifter.model import KoopmanModel

JUMP = 0.1  # change of theta* from one step to the next that is not a drift
WINDOW = 0.02  # of a run, over which the way to the optimum is averaged
COSTS_OF_RIGS = ("raw", "contrast")
LawRow = dict[str, Any]


@dataclass(frozen=True)
class LawPlant:
    """A plant with a cost, as an experiment file declares it.

    Attributes
    ----------
    name : str
        Of its table.
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


def rows(plant: LawPlant, constants: ScaledConstants, seeds: list[int]) -> Iterator[LawRow]:
    """Yield the figures of a law's run with each seed.

    Yields
    ------
    dict
        ``score``: on the paper's plant IAE; on a rig the rms amplitude over the second half of the
        run over that of the best fixed theta with the same noise (its inverse where the amplitude
        is to be maximised). ``failed``: 1 where the paper's tail error is above 0.6 or the rig's
        score above 1.5. ``swing``: the 5 to 95 % range of theta over the last 30 %, as a share of
        its range. ``converged``: when the mean over 2 % of the run first is within the same
        bounds, in seconds or in the rig's times; None if never. ``reacquired``: the same after
        each jump of the optimum, None where it did not before the next one.
    """
    if plant.family:
        for seed in seeds:
            yield _rig_row(plant, constants, seed)
        return
    for seed in seeds:
        case = case_of(plant.paper_settings(constants), seed)
        yield paper_row(case, paper.run(case))


def paper_row(case: Case, trace: paper.Trace) -> LawRow:
    """Return the row of a run on the paper's plant."""
    found = paper.measure(case, trace)
    if trace.diverged:
        return {"score": math.inf, "failed": 1.0, "swing": 1.0, "converged": None, "reacquired": []}
    displaced = displacement(case.scenario, case.steps, case.plant.dt)
    aligned = trace.theta - displaced if displaced.size else trace.theta
    span = case.esc.theta_max - case.esc.theta_min
    jumps = np.flatnonzero(np.abs(np.diff(displaced)) > JUMP) + 1
    return {
        "score": found["iae"],
        "failed": 1.0 - float(found["converged"] or 0.0),
        "swing": _swing((trace.theta - case.esc.theta_min) / span),
        **_times(np.abs(aligned - case.plant.theta_star), CONVERGED, jumps, case.plant.dt),
    }


def _rig_row(plant: LawPlant, constants: ScaledConstants, seed: int) -> LawRow:
    rig, model, noise = _drawn(json.dumps(asdict(plant), sort_keys=True), seed)
    p, done = rig.params, close(rig, scaled_to(rig, constants, model), noise, seed)
    gain, u = np.empty(done.theta.size), np.empty(done.theta.size)
    fill_gains(p, done.theta, gain, u)
    period = p.jump_every / p.dt if p.jump else math.inf
    jumps = np.array([round(i * period) for i in range(1, int((u.size - 1) / period) + 1)], int)
    return {
        "score": done.ratio,
        "failed": float(done.ratio > GOOD),
        "swing": _swing(u),
        **_times(gain, GOOD, jumps, p.dt / rig.time),
    }


@lru_cache(maxsize=4)  # as many as a unit of work has: the next law's unit has the same ones
def _drawn(plant: str, seed: int) -> tuple[Rig, KoopmanModel | None, RunNoise]:
    """Return a rig, the model of its cost, and the noise of its runs."""
    config = LawPlant(**json.loads(plant))
    rig = draw(config.rigs(), seed)
    model = None if config.cost == "raw" else learned_contrast(json.dumps(config.settings), seed)
    return rig, model, noise_of(rig, round(config.duration * rig.time / rig.params.dt), seed)


@njit()
def fill_gains(
    p: RigParams, theta: NDArray[np.float64], gain: NDArray[np.float64], u: NDArray[np.float64]
) -> None:
    """Fill in L(theta) over L* at each time, from 1 upwards, and the position of theta."""
    for k in range(theta.shape[0]):
        u[k] = oscillator.position(p, theta[k])
        ratio = oscillator.level(p, u[k], k * p.dt) / p.level
        gain[k] = ratio if p.sense > 0.0 else 1.0 / ratio


def _swing(u: NDArray[np.float64]) -> float:
    tail = u[-max(1, round(TAIL * u.size)) :]
    return float(np.subtract(*np.quantile(tail, [0.95, 0.05])))


def _times(
    away: NDArray[np.float64], bound: float, jumps: NDArray[np.int64], dt: float
) -> dict[str, Any]:
    """Return when ``away`` first is within a bound, and after each jump; ``dt`` is the unit."""
    width = max(1, round(WINDOW * away.size))
    edges = [0, *jumps.tolist(), away.size]
    first, *later = (
        _first_within(away[a:b], bound, min(width, b - a) if a == 0 else 1)
        for a, b in itertools.pairwise(edges)
    )
    times = [None if k is None else k * dt for k in (first, *later[:-1])]  # the last is cut short
    return {"converged": times[0], "reacquired": times[1:]}


def _first_within(away: NDArray[np.float64], bound: float, width: int) -> int | None:
    """Return the first sample up to which the mean of the last ``width`` is within ``bound``."""
    sums = np.concatenate([[0.0], np.cumsum(away)])
    inside = np.flatnonzero((sums[width:] - sums[:-width]) / width <= bound)
    return int(inside[0]) + width - 1 if inside.size else None


def law_runs(plant: dict[str, Any], constants: dict[str, Any], seeds: list[int]) -> list[LawRow]:
    """Return the figures of a law, one row a seed."""
    return list(rows(LawPlant(**plant), ScaledConstants(**constants), seeds))


WORK: dict[str, Callable[..., Any]] = {"law_runs": law_runs}
