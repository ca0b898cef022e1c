"""A tuning in words: table, summary, and the parameter file with its reasons."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from koop_core.text_table import table
from koop_tune.excitation.holds import spell_error
from koop_tune.excitation.safe_range import SafeRange
from koop_tune.excitation.static_map import MAP
from koop_tune.result.parameter_text import (
    OF_RIG,
    Parameters,
    annotated,
    list_guard,
    list_lifter,
)
from koop_tune.result.tune_result import TuneResult
from koop_tune.rig.rig_file import RigFile
from koop_tune.search.agreement import name_gains
from koop_tune.search.run import make_lifter
from koop_tune.search.tune_knobs import KnobsTuning
from koop_tune.search.tuning import Tuning


def as_table(result: TuneResult, names: Sequence[str] = ("theta",)) -> str:
    """Return the static maps and what each cost shows; empty where nothing reacts.

    ``names`` are those of the knobs.
    """
    if (fit := result.static_map) is None:
        return ""
    lines = [
        f"amplitude of {fit.feature}; 1 is the strongest seen, {fit.amplitude.floor:.2g} the "
        f"least that can be resolved; the oscillation's period is {fit.period:.3g} s"
    ]
    for k, each in result.maps.items():
        rows = [
            [f"{theta:.4g}", f"{amplitude:.4g}", spell_error(error)]
            for theta, amplitude, error in zip(*each.holds, strict=True)
        ]
        of, at = (f"{names[k]}: ", ", the others at theirs") if len(names) > 1 else ("", "")
        lines += [
            table([names[k], "amplitude", "error"], rows),
            f"{of}best at {each.theta_best:.4g}{at}; within a factor of {MAP.good:g} of that from "
            f"{each.valley.low:.4g} to {each.valley.high:.4g}",
        ]
    useless = [name for k, name in enumerate(names) if k not in result.maps]
    if useless and result.controller:
        lines.append(f"no effect, so they rest: {', '.join(useless)}")
    lines += [fit.moved] * bool(fit.moved)
    if fit.shares:
        lines.append("parts of the amplitude, their shares of its square over theta:")
        lines += [f"  {part}" for part in fit.shares]
    if result.costs:
        rows = []
        for cost in result.costs:
            best = "none inside" if cost.theta_best is None else f"{cost.theta_best:.4g}"
            score = "-" if cost.score is None else f"{cost.score:.3g}"
            rows.append([cost.name, best, f"{cost.evidence:.3g}", score])
        lines += ["", table(["cost", "best at theta", "evidence (Δχ²)", "score"], rows)]
        if len(names) > 1:
            lines.append(f"costs over {names[fit.knob]}, which shows the optimum best")
        if result.controller:
            lines.append(
                "score: amplitude over the best one and time to converge, also of a moving "
                "optimum; 1 is perfect; it ranks the costs, the prediction is below"
            )
        lines += [f"{cost.name}: {cost.problem}" for cost in result.costs if cost.problem]
    return "\n".join(lines)


def as_words(tuned: KnobsTuning) -> str:
    """Return the choice, its reason and the prediction."""
    tuning, p, names = tuned.tuning, tuned.prediction, tuned.rig.knob_names
    c, several = tuning.best.constants, len(names) > 1
    span = "of log theta's range" if tuning.findings.scale.logarithmic else "of theta's range"
    excess, reduction = name_gains(tuning.task.sense)
    notes = [f"in doubt: {tuning.findings.doubt}"] if tuning.findings.doubt else []
    if (safe := tuning.findings.safe) is not None and not safe.fixed:
        best = tuning.findings.scale.theta_at(tuning.findings.static_map.best())
        margin = f"margin {safe.margin_at(best):.2g} is predicted at {best:.4g}"
        notes.append(f"the constraint is kept from {safe.low:.4g} to {safe.high:.4g}: {margin}")
    notes += [f"always kept: {line.text}" for line in tuned.rig.lines]
    notes += [
        f"narrower{f', {name}' * several}: {limits.why}"
        for name, limits in zip(names, tuned.limits, strict=True) if limits.why
    ]  # fmt: skip
    many = f", {len(tuned.sections)} knobs one after another" * several
    return "\n".join(
        [
            *notes,
            f"cost {tuning.chosen.name}: {tuning.why}",
            f"law {c.law}, omega_h {c.omega_h:.3g} rad/s, omega_l {c.omega_l:.3g} rad/s, "
            f"dwell {c.dwell:.3g} s, tau_f {c.tau_f:.3g} s",
            f"predicted, from either end of the range{many} ({p.runs} runs; median, 5 to 95 %):",
            f"  converges within {p.converges.as_text()} s",
            f"  then |theta - theta*| is {p.distance.as_text(100.0)} % {span} on average",
            f"  {excess} {p.excess.as_text()}",
            *[f"  {reduction} {p.reduction.as_text()}"] * (not several),
        ]
    )


def list_parameters(
    tuned: KnobsTuning, model: Path | None, note: Path | None = None
) -> dict[str, Parameters]:
    """Return the parameters that are not the defaults by node, each with its reason."""
    return {
        "koopman_lifter": _lifter(tuned.tuning, tuned.rig, model),
        "relay_esc": _esc(tuned),
        "koop_guard": list_guard(tuned.rig, note),
    }


def _lifter(tuning: Tuning, rig: RigFile, model: Path | None) -> Parameters:
    c, period = tuning.best.constants, tuning.findings.period
    detector = make_lifter(tuning.task, c)
    searched = (
        f"the best of a search on the rig that the recording shows, whose oscillation has a period "
        f"of {period:.3g} s and whose amplitude follows theta within about "
        f"{tuning.time - 2.0 * period:.3g} s"
    )
    parameters: Parameters = {
        "cost": ("raw" if model is None else "lifted", tuning.why),
        "omega_h": (
            detector.omega_h,
            f"{c.omega_h * period / (2 * math.pi):.3g} times the oscillation's frequency; "
            + searched,
        ),
        "omega_l": (
            detector.omega_l,
            f"averages over {1.0 / c.omega_l:.3g} s, {1 / c.omega_l / period:.3g} periods; of the "
            "same search",
        ),
        "y_out_max": (float(f"{tuning.y_out_max:.3g}"), "ten times the largest of the recording"),
    }
    if frequency := tuning.findings.frequency:
        parameters["begin"] = float(f"{frequency:.3g}"), "most of what reacts to theta is there"
    if model is not None:  # beside the file: the folder may be moved
        parameters["model"] = (model.name, "learned from the excitation")
    return parameters | list_lifter(rig)


def _esc(tuned: KnobsTuning) -> Parameters:
    tuning, rig, esc = tuned.tuning, tuned.rig, tuned.esc
    c, findings, time = tuning.best.constants, tuning.findings, tuning.time
    logarithmic = esc.theta_scale == "log"
    ratio = min(s.high / s.low if s.low else math.nan for s in rig.scales)
    low, high = (
        "; ".join(why for why in dict.fromkeys(whys) if why)
        for whys in zip(*((each.why_low, each.why_high) for each in tuned.limits), strict=True)
    )
    if rig.count == 1:
        crosses = f"crosses the range in {rig.dt * findings.scale.span / esc.step_size:.3g} s"
    else:
        ways = [(knob.scaled(knob.theta_max) - knob.scaled(knob.theta_min)) / knob.step_size
                for knob in esc.knobs()]  # fmt: skip
        crosses = f"each goes from limit to limit within {rig.dt * max(ways):.3g} s"
    reasons = {
        "law": "of the same search",
        "theta_scale": f"theta's limits are a factor of {ratio:.3g} apart" if logarithmic
        else "a line between knobs is not a ratio of two" if all(s.logarithmic for s in rig.scales)
        else "theta's limits are not far apart by a factor, or not above 0",
        "step_size": f"{crosses}; within theta_rate",
        "step_ratio": "of the same search",
        "dwell": f"{c.dwell / time:.3g} times the rig's own time of {time:.3g} s",
        "tau_f": f"{c.tau_f / time:.3g} times the rig's own time",
        "theta_min": low or OF_RIG,
        "theta_max": high or OF_RIG,
        "widest": "the rig file's limits, but beside a cliff: if the optimum leaves, theta follows",
        "rate_limit": "theta_rate of the rig file"
        + (" over theta_max: the rate of log theta" if logarithmic else ""),
        "objective": OF_RIG,
        "theta_initial": "theta_safe of the rig file: from there the guard lets it command",
    }  # fmt: skip
    if not esc.widest:
        del reasons["widest"]
    parameters: Parameters = {name: (getattr(esc, name), why) for name, why in reasons.items()}
    if esc.constraint:
        parameters["constraint"] = (esc.constraint, OF_RIG)
    if findings.safe is not None and not findings.safe.fixed:
        slope = float(f"{findings.safe.slope(findings.scale):.3g}")
        parameters["margin_slope"] = (slope, describe_barrier(findings.safe, slope))
    return parameters


def describe_barrier(safe: SafeRange, slope: float) -> str:
    """Return in words what keeps the bound of the constraint."""
    if slope != 0.0:
        return "the steepest that was seen towards the bound: the barrier keeps it, if it moves too"
    sides = "both sides" if safe.bound_low else "no side"
    return f"the constraint ends theta's range on {sides}: theta's limits alone keep it"


def as_parameters(tuned: KnobsTuning, model: Path | None, note: Path | None = None) -> str:
    """Return the annotated parameter file; ``note`` is where theta's last value is noted."""
    listed = list_parameters(tuned, model, note)
    return annotated((*listed, "recorder"), listed)
