"""One rig with several knobs commissioned: excited, tuned, verified from two opposite corners."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_identify.recording.loaded import Loaded
from koop_study.commissioning.excitation import as_loaded, excite, longest, training_of
from koop_study.commissioning.work import EARLIER, NEXT
from koop_study.family.config import FamilyConfig
from koop_study.family.knobs import KnobsRig, draw_knobs
from koop_study.family.loop import RigController, close, noise_of
from koop_study.family.rig import RandomRig
from koop_tune.excitation.bowl import find_starts
from koop_tune.excitation.design import KNOWN
from koop_tune.result.summary import summarise
from koop_tune.search.agreement import find_disagreements, find_faults, measure
from koop_tune.search.findings import NoOptimum
from koop_tune.search.rounds import LoopRun, Round, find_slowdown, inform, kept_index
from koop_tune.search.run import make_lifter
from koop_tune.search.settings import VERIFICATION, TuningSettings
from koop_tune.search.tune_knobs import tune_knobs

Array = NDArray[np.float64]


def commission_knobs(
    n: int, condition: float, useless: bool, family: dict[str, Any], seed: int, rate: float,
    excitation: float, duration: float, effort: float,
) -> dict[str, Any]:  # fmt: skip
    """Commission one rig with n knobs, in as many rounds as ``koop commission`` takes.

    Parameters
    ----------
    n, condition, useless, family, seed
        As of :func:`koop_study.family.knobs.draw_knobs`.
    rate, excitation, duration, effort
        As of :func:`koop_study.commissioning.work.commission_plant`, the times for each knob.

    Returns
    -------
    dict
        The verdict, the amplitude at the best hold over the true best, and that of the loops.
    """
    rig = draw_knobs(FamilyConfig(**family), seed, n, condition, useless)
    own, dt = rig.rig, rig.rig.params.dt
    file = rig.file(rate, n * longest(own, excitation))
    recorded = excite(own, file, seed + EARLIER, rig)
    design = recorded.design
    row: dict[str, Any] = {
        "seed": seed, "start": rig.excess(rig.start), "held": rig.excess(design.base),
        "holds": len(design.held), "excited": recorded.elapsed / own.time, "damped": False,
    }  # fmt: skip
    if design.ended != KNOWN or design.amplitude is None:
        return {**row, "verdict": design.ended or "time"}
    steps, loaded = n * round(duration * own.time / dt), recorded.loaded
    rounds: list[Round] = []
    tried: list[tuple[list[str], list[float]]] = []
    start: Any
    while len(rounds) < VERIFICATION.rounds and not (rounds and rounds[-1].damped):
        number = seed + len(rounds) * NEXT
        settings = TuningSettings(
            seed=seed + len(rounds), effort=effort, slowdown=find_slowdown(rounds), workers=1
        )
        try:
            tuning = tune_knobs(
                loaded, file, design.lines, training_of(own), design.amplitude, settings
            )
        except NoOptimum as no:
            return {**row, "verdict": no.kind, "why": str(no)}
        aim = inform(summarise(tuning).make_aim(file), rounds)
        lifter = make_lifter(tuning.tuning.task, tuning.tuning.best.constants)
        rests = aim.settings.before * max(aim.amplitude.windows.length, round(aim.time / dt))
        runs, ratios, parts = [], [], [loaded]
        for start in find_starts(file, *design.arrays):
            begin, there, before = _rest(rig, start, rests, number + 2)
            esc = replace(tuning.esc, theta_initial=start)
            controller = RigController(lifter, esc, tuning.tuning.chosen.maps.cost.model)
            noise = noise_of(begin, round(aim.longer * steps), number)
            run = close(begin, controller, noise, number, rig)
            measured = measure(aim, before, run.x, run.theta)
            runs.append(LoopRun(start, measured))
            ratios.append(run.ratio)
            _, where, after = _rest(rig, measured.theta, rests, number + 2)
            path = np.concatenate([there, run.theta, where])
            parts.append(as_loaded(path, np.concatenate([before, run.x, after]), dt))
        loaded, figures = Loaded.joined(parts), [run.measured for run in runs]
        faults = find_faults(aim, figures)
        agrees = not any(find_disagreements(aim, one) for one in figures)
        rounds.append(
            Round(len(rounds) + 1, aim.predicted, tuple(runs), agrees, not faults, best=aim.y)
        )
        tried.append((faults, ratios))
    which = kept_index(rounds)
    faults, ratios = tried[which]
    return {
        **row, "verdict": "tuned", "rounds": len(rounds), "faults": faults,
        "damped": rounds[which].damped, "ratio": ratios,
    }  # fmt: skip


def _rest(
    rig: KnobsRig, theta: tuple[float, ...], count: int, seed: int
) -> tuple[RandomRig, Array, Array]:
    """Return the rig settled at a theta, and that and the channels for so many samples."""
    settled = rig.starting_at(np.array(theta))
    x = settled.record(np.full(count, settled.theta_initial), seed)[0]
    return settled, np.tile(theta, (count, 1)), x
