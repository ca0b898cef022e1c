"""One rig of the family commissioned: excited, tuned and verified."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_identify.recording.loaded import Loaded
from koop_study.commissioning.excitation import (
    SimulatedExcitation,
    as_loaded,
    excite,
    file_of,
    training_of,
)
from koop_study.family.config import FamilyConfig
from koop_study.family.loop import (
    ClosedRun,
    RigController,
    RunNoise,
    close,
    from_end,
    noise_of,
)
from koop_study.family.rig import RandomRig, draw
from koop_tune.excitation.bowl import find_starts
from koop_tune.excitation.design import FLAT, KNOWN
from koop_tune.result.summary import summarise
from koop_tune.rig.rig_file import RigFile
from koop_tune.search.agreement import (
    Aim,
    find_disagreements,
    find_faults,
    measure,
    with_hold,
)
from koop_tune.search.findings import NoOptimum
from koop_tune.search.rounds import LoopRun, Round, find_slowdown, inform, kept_index
from koop_tune.search.run import make_lifter
from koop_tune.search.settings import VERIFICATION, TuningSettings
from koop_tune.search.tune_knobs import tune_knobs
from koop_tune.search.tuning import Tuning

# added to the seed: of the excitation, of the other end's noise, of the noise of the next round
EARLIER, OTHER, NEXT = 1_000_000, 2_000_000, 20_000_000
ENDS = (0, 1)
Row = dict[str, Any]


def commission_plant(
    stratum: str, family: dict[str, Any], seed: int, rate: float, excitation: float,
    duration: float, effort: float,
) -> Row:  # fmt: skip
    """Commission one rig.

    Parameters
    ----------
    stratum : str
        Name of the family.
    family : dict
        Settings of the family.
    seed : int
        Seed of the rig.
    rate : float
        Largest change of theta: ranges in the rig's own time.
    excitation : float
        Longest time of the excitation, see :func:`koop_study.commissioning.excitation.file_of`.
    duration : float
        Length of a run of verification, in the rig's own time.
    effort : float
        Budget of the search (1: as usual).

    Returns
    -------
    dict
        The rig, its verdict, and how the controller did from either end, or, where a refusal
        names one, the limit of theta at which it is to be left.
    """
    rig = draw(FamilyConfig(**family), seed)
    file = file_of(rig, rate, excitation)
    recorded = excite(rig, file, seed + EARLIER)
    row: Row = {"stratum": stratum, "seed": rig.seed, "shape": rig.map,
                "has_optimum": rig.has_optimum, "damped": False,
                "excited": recorded.elapsed / rig.time}  # fmt: skip
    after = rig.later(recorded.elapsed)  # while theta was moved the optimum moved too
    loops = Loops(after, seed, round(duration * rig.time / rig.params.dt))
    try:
        if recorded.design.ended == FLAT:
            raise NoOptimum("flat", "nothing reacts")
        if recorded.design.ended != KNOWN:
            raise NoOptimum("time", "the time was over before the map was known")
        tuning = commissioned(rig, file, recorded, loops, seed, effort, row)
        row |= {"verdict": "tuned", "why": tuning.why}
    except NoOptimum as no:
        row |= {"verdict": no.kind, "why": str(no)}
        if no.findings and no.kind == "monotone":  # "leave theta there"
            theta = file.theta_max if no.findings.static_map.best_end else file.theta_min
            row["advised"] = after.excess(theta, duration * rig.time)
    except ValueError as error:
        row |= {"verdict": "error", "why": str(error)}
    return row


def commissioned(
    rig: RandomRig, file: RigFile, recorded: SimulatedExcitation, first: Loops, seed: int,
    effort: float, row: Row,
) -> Tuning:  # fmt: skip
    """Tune and verify, as often as ``koop commission`` does; note the outcome in the row.

    A later round learns from the loops of the earlier ones, whose noise it does not repeat.
    """
    rounds: list[Round] = []
    tried: list[tuple[Tuning, list[float]]] = []
    design, loaded = recorded.design, recorded.loaded
    starts = [tuple(np.atleast_1d(start)) for start in find_starts(file, *design.arrays)]
    while len(rounds) < VERIFICATION.rounds and not (rounds and rounds[-1].damped):
        settings = TuningSettings(
            seed=seed + len(rounds), effort=effort, slowdown=find_slowdown(rounds), workers=1
        )
        training = training_of(rig)
        tuned = tune_knobs(
            loaded, file, design.lines, design.arrays, training, design.amplitude, settings
        )
        tuning = tuned.tuning
        passed = loaded.x.shape[1] - recorded.loaded.x.shape[1]
        aim = inform(summarise(tuned).make_aim(file), rounds)
        loops = first.later(len(rounds), aim.longer, passed) if rounds else first
        lifter = make_lifter(tuning.task, tuning.best.constants)
        closed = loops.close(RigController(lifter, tuned.esc, tuning.chosen.maps.cost.model))
        before = [loops.rest(end, start, aim, 3 * OTHER) for end, start in enumerate(starts)]
        runs, held = [], []
        for end, (start, rest, loop) in enumerate(zip(starts, before, closed, strict=True)):
            measured = measure(aim, rest, loop.x, loop.theta)
            held.append(loops.rest(end + 1, measured.theta, aim, 5 * OTHER))
            runs.append(LoopRun(start, with_hold(aim, measured, held[-1])))
        agrees = not any(find_disagreements(aim, run.measured) for run in runs)
        damped = not find_faults(aim, [run.measured for run in runs])
        rounds.append(Round(len(rounds) + 1, aim.predicted, tuple(runs), agrees, damped, "", aim.y))
        tried.append((tuning, [loop.ratio for loop in closed]))
        for rest, loop, run, after in zip(before, closed, runs, held, strict=True):
            there = np.tile(run.start, (len(rest), 1))
            where = np.tile(run.measured.theta, (len(after), 1))
            path = np.concatenate([there, loop.theta.reshape(-1, file.count), where])
            path = path if file.count > 1 else path[:, 0]
            recording = as_loaded(path, np.concatenate([rest, loop.x, after]), file.dt)
            loaded = Loaded.joined([loaded, recording])
    which = kept_index(rounds, file.sense)
    tuning, row["ratio"] = tried[which]
    row["damped"] = rounds[which].damped
    return tuning


class Loops:
    """The loop of a rig closed from both ends in turn."""

    def __init__(self, rig: RandomRig, seed: int, steps: int) -> None:
        self._rig, self._seed, self._steps = rig, seed, steps

    def later(self, number: int, longer: float, passed: int) -> Loops:
        """Return the loops of a later round, so many samples on: with noise of its own, longer."""
        rig = self._rig.later(passed * self._rig.params.dt)
        return Loops(rig, self._seed + number * NEXT, round(longer * self._steps))

    def _after(self, count: int) -> RandomRig:
        """Return the rig as so many loops leave it: its optimum moves on."""
        return self._rig.later(count * self._steps * self._rig.params.dt)

    @property
    def rigs(self) -> list[RandomRig]:
        """At rest at each end, when the loop is closed from there."""
        return [from_end(self._after(end), end) for end in ENDS]

    @property
    def noises(self) -> list[RunNoise]:
        """From each end."""
        return [noise_of(rig, self._steps, self._seed + end * OTHER)
                for end, rig in enumerate(self.rigs)]  # fmt: skip

    def rest(
        self, count: int, theta: tuple[float, ...], aim: Aim, other: int
    ) -> NDArray[np.float64]:
        """Return what is measured, after so many loops, once the rig has settled at a theta."""
        windows = aim.amplitude.windows
        steps = aim.settings.before * max(windows.length, round(aim.time / windows.dt))
        rig = self._settled(count, theta)
        return rig.record(np.full(steps, rig.theta_initial), self._seed + other + count)[0]

    def _settled(self, count: int, theta: tuple[float, ...]) -> RandomRig:
        return replace(self._after(count), theta_initial=theta[0])

    def close(self, controller: RigController) -> list[ClosedRun]:
        """Close it with a controller."""
        ends = enumerate(zip(self.rigs, self.noises, strict=True))
        return [close(rig, controller, noise, self._seed + end * OTHER)
                for end, (rig, noise) in ends]  # fmt: skip
