"""A controller of all knobs, from the sections of their static map through the best.

A rig with one knob has one section. With several, the search is that of one knob, on the section
that shows the optimum best. The others follow from their limits: in units of the way between its
limits each section rises alike, to the same factor of the best at both of them, so all knobs cross
that way in the same time. The controller seeks along one direction after another
(:mod:`relay_esc.directions`): its loop is predicted by runs of it (:mod:`.run_knobs`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_identify.model.compare import energies
from koop_identify.model.from_bags import BagTraining
from koop_identify.recording.loaded import Loaded
from koop_tune.excitation.amplitude import Amplitude
from koop_tune.excitation.bowl import find_starts, fit_bowl
from koop_tune.excitation.knobs_design import KNOBS
from koop_tune.excitation.safe_range import SafeRange
from koop_tune.excitation.static_map import StaticMap
from koop_tune.rig.rig_file import RigFile
from koop_tune.rig_model.dwells import Dwells, find_dwells
from koop_tune.rig_model.surrogate import high_pass
from koop_tune.search.findings import STRONGER, CostMaps, NoOptimum
from koop_tune.search.limits import ThetaLimits, limit_corners, limit_theta
from koop_tune.search.prediction import Prediction, describe_runs
from koop_tune.search.run import make_esc, round_digits
from koop_tune.search.run_knobs import make_knobs_task
from koop_tune.search.settings import TUNING, TuningSettings
from koop_tune.search.tuning import Report, Tuning, tune
from relay_esc.config import EscConfig

Array = NDArray[np.float64]


@dataclass(frozen=True)
class KnobsTuning:
    """A controller of one knob or several.

    Attributes
    ----------
    rig : RigFile
        The rig.
    knob : int
        That of the section on which the constants were searched.
    tuning : Tuning
        The search.
    sections, rigs : dict of int to StaticMap and RigFile
        Map over each knob that has an effect, through the best, and the rig with it alone there.
    limits : list of ThetaLimits
        Of each knob; of one without effect, close around its start.
    esc : EscConfig
        The controller.
    prediction : Prediction
        Figures of its loop.
    """

    rig: RigFile
    knob: int
    tuning: Tuning
    sections: dict[int, StaticMap]
    rigs: dict[int, RigFile]
    limits: list[ThetaLimits]
    esc: EscConfig
    prediction: Prediction

    @classmethod
    def of_one(cls, rig: RigFile, tuning: Tuning) -> KnobsTuning:
        """Return that of a rig with one knob."""
        findings = tuning.findings
        esc = make_esc(tuning.task, tuning.best.constants, rig.theta_safe)
        sections, limits = {0: findings.static_map}, [findings.limits]
        return cls(rig, 0, tuning, sections, {0: rig}, limits, esc, tuning.prediction)


def tune_knobs(
    loaded: Loaded, rig: RigFile, lines: Mapping[int, Array], holds: tuple[Array, Array, Array],
    training: BagTraining, amplitude: Amplitude | None, settings: TuningSettings = TUNING,
    report: Report = lambda step: None, safe: SafeRange | None = None,
) -> KnobsTuning:  # fmt: skip
    """Choose the cost and all constants of a controller.

    Parameters
    ----------
    loaded : Loaded
        The excitation; of n > 1 knobs its theta has the shape (M, n).
    rig : RigFile
        Limits, rates, objective, dt.
    lines : mapping of int to ndarray, shape (n,)
        With several knobs, a position of the section of each that has an effect.
    holds : tuple of ndarray
        Positions, y and errors of the excitation's, as of :func:`.fit_bowl`.
    training, amplitude, settings, report, safe
        As of :func:`koop_tune.search.tuning.tune`.

    Raises
    ------
    NoOptimum
        If there is no optimum to seek, or the cost does not lead to that of a knob.
    """
    if rig.count == 1:
        tuning = tune(loaded, rig, training, amplitude, settings, report, safe)
        return KnobsTuning.of_one(rig, tuning)
    if amplitude is None or not lines:
        raise NoOptimum("unknown", "the map over the knobs is not known: record with "
                        "'koop excite', until it says that the map is known")  # fmt: skip
    # where all knobs are at their limits, what each adds to the square adds up
    settings = replace(settings, limits=math.sqrt(1.0 + (settings.limits**2 - 1.0) / len(lines)))
    rigs = {k: rig.section(k, rig.theta_at(line)) for k, line in lines.items()}
    parts = {k: cut_section(loaded, rig, k, line) for k, line in lines.items()}
    dwells = {
        k: find_dwells(part, rigs[k].scale, amplitude, rig.sense) for k, part in parts.items()
    }
    sections = {k: d.static_map(d.logs, rig.sense) for k, d in dwells.items()}
    change = {k: float(np.ptp(section.mean)) for k, section in sections.items()}
    knob = max(sections, key=lambda k: (change[k] >= settings.slight, sections[k].evidence))
    room = _find_safe(rig.knob(knob), rigs[knob])
    try:
        tuning = tune(parts[knob], rigs[knob], training, amplitude, settings, report, room)
    except NoOptimum as no:
        there = zip(rig.knob_names, rig.theta_at(lines[knob]), strict=True)
        name = rig.knob_names[knob]
        others = ", ".join(f"{other} = {theta:.4g}" for other, theta in there if other != name)
        text = f"over {name}, which shows the optimum best, with {others}: {no}"
        raise NoOptimum(no.kind, text, no.findings, knob) from None
    # along another knob it may have needed longer to grow
    growth = max(each.growth for each in dwells.values())
    held = replace(tuning.findings.dwells, growth=growth)
    tuning = replace(tuning, findings=replace(tuning.findings, dwells=held))
    for k in sections:
        if k != knob:
            _refuse_astray(tuning, parts[k], dwells[k], sections[k], rig.knob_names[k], settings)
    sections[knob] = tuning.findings.static_map
    limits = [
        limit_theta(sections[k], rigs[k], settings) if k in sections else _rest(rig.knob(k))
        for k in range(rig.count)
    ]
    limits[knob] = tuning.findings.limits
    best = rig.u(rig.each("theta_start"))
    for k, one in rigs.items():
        best[k] = rig.scales[k].u(np.array(one.scale.theta_at(sections[k].best())))
    effective = sorted(sections)
    if not rig.lines:  # which cut corners off
        limits = limit_corners(rig, limits, best, effective, holds, settings)
    ends = np.array([limit[:2] for limit in limits])
    for k, one in rigs.items():  # along a line between knobs theta may go on
        if limits[k].low == one.theta_min:
            limits[k] = limits[k]._replace(low=rig.each("theta_min")[k])
        if limits[k].high == one.theta_max:
            limits[k] = limits[k]._replace(high=rig.each("theta_max")[k])
    places = np.array([rig.theta_at(line) for line in lines.values()])
    for k, limit in enumerate(limits) if rig.lines else ():  # which keep the lines
        low, high = min(limit.low, *places[:, k]), max(limit.high, *places[:, k])
        limits[k] = limit._replace(low=float(low), high=float(high))
    esc = _make_esc(tuning, rig, knob, ends, limits)
    u, y, error = holds
    bowl = fit_bowl(u[:, effective], y, error)
    several = make_knobs_task(
        tuning.task, rig, knob, rigs[knob].scale, best, bowl, effective, find_starts(rig, *holds)
    )
    seed, constants = settings.seed + 1, tuning.best.constants
    runs = [several.try_out(esc, constants, i, seed) for i in range(settings.runs)]
    prediction = describe_runs(several.task, runs, tuning.findings, seed)
    return KnobsTuning(rig, knob, tuning, sections, rigs, limits, esc, prediction)


def _find_safe(whole: RigFile, part: RigFile) -> SafeRange | None:
    """Return what lines between knobs leave of a knob's limits; None: all."""
    cut = part.theta_min > whole.theta_min, part.theta_max < whole.theta_max
    ends = part.theta_min, part.theta_max
    return SafeRange(ends, (1.0, 1.0), *ends, *cut, True) if any(cut) else None


def cut_section(loaded: Loaded, rig: RigFile, knob: int, line: Array) -> Loaded:
    """Return the parts of a recording in which all other knobs were where the section is."""
    assert loaded.theta is not None
    away = [
        np.abs(one.scale.u(loaded.theta[:, k]) - line[k])
        for k, one in enumerate(rig.knobs()) if k != knob
    ]  # fmt: skip
    on = np.max(away, axis=0) <= KNOBS.same
    begins = loaded.begins | ~np.r_[False, on[:-1]]
    return replace(
        loaded, x=np.ascontiguousarray(loaded.x[:, on]), begins=begins[on],
        theta=np.ascontiguousarray(loaded.theta[on, knob]), time=loaded.time[on],
    )  # fmt: skip


def _refuse_astray(
    tuning: Tuning, part: Loaded, dwells: Dwells, section: StaticMap, name: str,
    settings: TuningSettings,
) -> None:  # fmt: skip
    """Refuse a cost that leads elsewhere than the amplitude along a knob."""
    cost, omega_h = tuning.chosen.maps.cost, tuning.best.constants.omega_h
    y_out = energies(cost.model, part.x, part.begins)
    levels = dwells.window_levels(high_pass(y_out, part, omega_h, tuning.task.dt))
    found = dwells.static_map(levels, section.sense)
    if not CostMaps(cost, {omega_h: found}, section, settings.near).leads_to_optimum(found):
        raise NoOptimum(
            "drowned",
            f"the cost {cost.name} does not lead to the optimum of {name}: noise or interference "
            f"drowns it; {STRONGER}",
            tuning.findings,
        )


def _rest(rig: RigFile) -> ThetaLimits:
    """Return limits close around the start of a knob without effect."""
    scale, u = rig.scale, rig.u_start
    low, high = (u + side * TUNING.least_room for side in (-1.0, 1.0))
    ends = scale.theta_at(max(low, 0.0)), scale.theta_at(min(high, 1.0))
    return ThetaLimits(*ends, "it has no effect", "it has no effect")


def _make_esc(
    tuning: Tuning, rig: RigFile, knob: int, ends: Array, limits: list[ThetaLimits]
) -> EscConfig:
    """Return the controller: each knob crosses the way between its ends in the same time."""
    task, constants = tuning.task, tuning.best.constants
    knobs = rig.knobs()
    ratios = all(line.as_ratio() is not None for line in rig.lines)
    logarithmic = ratios and all(one.scale.logarithmic for one in knobs)
    ways = np.diff(np.log(ends) if logarithmic else ends)[:, 0]
    rates = [one.theta_rate / (one.theta_max if logarithmic else 1.0) for one in knobs]
    low, high = task.scale.u(ends[knob])
    share = constants.speed * rig.dt / float(high - low)  # of the way, in a sample
    share = min(share, float((np.array(rates) * rig.dt / ways).min()))
    each: dict[str, Any] = {
        "step_size": [round_digits(float(way)) for way in share * ways],
        "theta_min": [limit.low for limit in limits],
        "theta_max": [limit.high for limit in limits],
        "rate_limit": rates,
        "theta_initial": [knob.theta_safe for knob in knobs],
    }
    each = {name: tuple(values) for name, values in each.items()}
    each |= {"theta_scale": "log" if logarithmic else "linear", "widest": ()}
    each["constraint"] = rig.theta_lines
    return replace(make_esc(task, constants, task.low), **each)
