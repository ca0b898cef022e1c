"""Rigs with several knobs: what a tuning says of their loop, beside the loop itself."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from koop_study.commissioning.excitation import excite, longest, training_of
from koop_study.commissioning.knobs import KnobsLoops
from koop_study.commissioning.work import EARLIER
from koop_study.family.config import FamilyConfig
from koop_study.family.knobs import draw_knobs
from koop_study.family.loop import RigController
from koop_tune.excitation.bowl import find_starts
from koop_tune.excitation.design import KNOWN
from koop_tune.search.run import make_lifter
from koop_tune.search.settings import TuningSettings
from koop_tune.search.tune_knobs import tune_knobs

EASY = FamilyConfig(
    frequency=(1.0, 1.0), amplitude_time=(2.0, 2.0), channels=(1, 1), depth=(10.0, 10.0),
    clean=1.0, maps={"symmetric": 1.0},
)  # fmt: skip


def test_a_loop_of_several_knobs_is_predicted_as_the_rig_then_does_it() -> None:
    """Failed before: 2 n times what one knob takes; the reduction was not predicted at all."""
    rig = draw_knobs(EASY, 3, 2, 3.0, False)
    own, dt = rig.rig, rig.rig.params.dt
    file = rig.file(0.5, 1e4)
    recorded = excite(own, file, 1, rig)
    design = recorded.design
    tuned = tune_knobs(
        recorded.loaded, file, design.lines, design.arrays, training_of(own), design.amplitude,
        TuningSettings(effort=0.1, workers=1),
    )  # fmt: skip
    tuning, p = tuned.tuning, tuned.prediction
    starts = find_starts(file, *design.arrays)
    lifter = make_lifter(tuning.task, tuning.best.constants)
    controller = RigController(lifter, tuned.esc, tuning.chosen.maps.cost.model)
    closed = KnobsLoops(rig, starts, 2, round(p.duration / dt)).close(controller)
    grid = np.linspace(own.params.theta_min, own.params.theta_max, 401)
    logs = np.log([own.amplitude(float(theta)) for theta in grid])
    best = float(np.log(own.amplitude(float(rig.theta(rig.best[None])[0]))))
    for start, loop in zip(starts, closed, strict=True):
        begin = np.log(rig.excess(np.array(start)))
        path = np.interp(rig.theta(loop.theta), grid, logs) - best
        keep = np.exp(-dt / EASY.amplitude_time[0])  # as the amplitude follows
        path, _ = lfilter([1.0 - keep], [1.0, -keep], path, zi=[keep * begin])
        took = float(np.argmax(path <= np.log(1.5)) * dt)
        assert p.converges.low <= took <= p.converges.high
        assert p.excess.low <= loop.ratio <= p.excess.high
        assert p.reduction.low <= np.exp(begin) / loop.ratio <= p.reduction.high
    assert p.converges.high < 3.0 * p.converges.low
    assert p.reduction.high < 6.0 * p.reduction.low  # its starts differ by a factor of 3


def test_a_map_is_not_known_while_its_best_hold_lies_beside_all_sections() -> None:
    """Failed before: the sections' best was 2.5 times that hold, and so were the loops."""
    family = FamilyConfig(
        frequency=(1.0, 1.0), amplitude_time=(2.0, 6.0), channels=(1, 2), depth=(5.0, 30.0),
        maps={"symmetric": 1.0, "asymmetric": 1.0, "flat-bottomed": 1.0},
    )  # fmt: skip
    rig = draw_knobs(family, 5002, 2, 10.0, False)
    file = rig.file(0.5, 2.0 * longest(rig.rig, 300.0))
    design = excite(rig.rig, file, 5002 + EARLIER, rig).design
    assert design.ended == KNOWN
    assert rig.excess(design.base) < 1.5
    best = []
    for knob, line in design.lines.items():
        place = line.copy()
        place[knob] = design.section(knob).best()
        best.append(rig.excess(place))
    assert min(best) < 1.5
