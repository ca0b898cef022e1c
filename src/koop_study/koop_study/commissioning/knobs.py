"""One rig with several knobs commissioned: excited, tuned, verified from two opposite corners."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from koop_study.commissioning.excitation import excite, longest, training_of
from koop_study.commissioning.work import EARLIER
from koop_study.family.config import FamilyConfig
from koop_study.family.knobs import draw_knobs
from koop_study.family.loop import RigController, close, noise_of
from koop_tune.excitation.bowl import find_starts
from koop_tune.excitation.design import KNOWN
from koop_tune.result.summary import summarise
from koop_tune.search.agreement import find_faults, measure
from koop_tune.search.findings import NoOptimum
from koop_tune.search.run import make_lifter
from koop_tune.search.settings import TuningSettings
from koop_tune.search.tune_knobs import tune_knobs


def commission_knobs(
    n: int, condition: float, useless: bool, family: dict[str, Any], seed: int, rate: float,
    excitation: float, duration: float, effort: float,
) -> dict[str, Any]:  # fmt: skip
    """Commission one rig with n knobs.

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
    settings = TuningSettings(seed=seed, effort=effort, workers=1)
    try:
        tuning = tune_knobs(
            recorded.loaded, file, design.lines, training_of(own), design.amplitude, settings
        )
    except NoOptimum as no:
        return {**row, "verdict": no.kind, "why": str(no)}
    lifter = make_lifter(tuning.tuning.task, tuning.tuning.best.constants)
    aim, runs = summarise(tuning).make_aim(file), []
    steps = n * round(duration * own.time / dt)
    rests = aim.settings.before * max(aim.amplitude.windows.length, round(aim.time / dt))
    start: Any
    for start in find_starts(file, *design.arrays):
        begin = rig.starting_at(np.array(start))
        before = begin.record(np.full(rests, begin.theta_initial), seed + 2)[0]
        esc = replace(tuning.esc, theta_initial=start)
        controller = RigController(lifter, esc, tuning.tuning.chosen.maps.cost.model)
        noise = noise_of(begin, steps, seed)
        runs.append((before, close(begin, controller, noise, seed, rig)))
    faults = find_faults(aim, [measure(aim, before, run.x, run.theta) for before, run in runs])
    return {
        **row, "verdict": "tuned", "faults": faults,
        "damped": not faults, "ratio": [run.ratio for _, run in runs],
    }  # fmt: skip
