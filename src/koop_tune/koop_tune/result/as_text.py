"""What a tuning comes to in words: the table, the parameter file with its reasons."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from koop_core.config.describe import parameter_file
from koop_core.config.fields import format_field
from koop_core.text_table import table
from koop_tune.result.parameter_text import HEAD, KNOWN
from koop_tune.rig.rig_file import RigFile
from koop_tune.search.search import esc_of, lifter_of
from koop_tune.search.tuning import Seen, Tuning

LEAST_TIMEOUT, TIMEOUT = 0.5, 20.0  # [s]; samples


def as_table(seen: Seen) -> str:
    """Return the static map and what each cost shows of it."""
    theta = seen.scale.theta(seen.stays.u)
    rows = [
        [f"{value:.4g}", f"{math.exp(mean):.4g}", f"{100 * error:.2g} %", str(own.size)]
        for value, mean, error, own in zip(
            theta, seen.amplitude.mean, seen.amplitude.error, seen.amplitude.visits, strict=True
        )
    ]
    lines = [
        f"amplitude of {seen.feature}; the oscillation's period is {seen.period:.3g} s",
        table(["theta", "amplitude", "error", "stays"], rows),
    ]
    if seen.costs:
        rows = []
        for judged in seen.costs:
            if not judged.maps:
                rows.append([judged.cost.name, "-", "-", "-"])
                continue
            best = max(judged.maps.values(), key=lambda found: found.gain)
            where = f"{seen.scale.theta_at(best.best()):.4g}"
            score = f"{math.exp(judged.tried[0].score):.3g}" if judged.tried else "-"
            inside = where if judged.usable else "none inside"
            rows.append([judged.cost.name, inside, f"{best.gain:.3g}", score])
        lines += ["", table(["cost", "best at theta", "how sure", "score"], rows)]
        lines += [f"{j.cost.name}: {j.cost.problem}" for j in seen.costs if j.cost.problem]
    return "\n".join(lines)


def as_words(found: Tuning) -> str:
    """Return what was chosen, why, and what it will do."""
    c, p = found.best.constants, found.prediction
    s = found.task.any
    span = "of log theta's range" if s.logarithmic else "of theta's range"
    better = "down" if found.task.sense > 0 else "up"
    doubt = [f"in doubt: {found.seen.doubt}"] if found.seen.doubt else []
    doubt += [f"narrower: {found.seen.limits.why}"] if found.seen.limits.why else []
    return "\n".join(
        [
            *doubt,
            f"cost {found.chosen.cost.name}: {found.why}",
            f"law {c.law}, omega_h {c.omega_h:.3g} rad/s, omega_l {c.omega_l:.3g} rad/s, "
            f"dwell {c.dwell:.3g} s, tau_f {c.tau_f:.3g} s",
            f"predicted, from either end of the range ({p.runs} runs; median, 5 to 95 %):",
            f"  converges in {p.converges.as_text()} s",
            f"  then |theta - theta*| is {p.distance.as_text(100.0)} % {span} on average",
            f"  amplitude over the best one {p.excess.as_text()}",
            f"  amplitude {better} by a factor of {p.reduction.as_text()}",
        ]
    )


def nodes_of(found: Tuning, rig: RigFile, model: Path | None) -> dict[str, dict[str, Any]]:
    """Return the parameters that are not the defaults, by node."""
    esc = esc_of(found.task, found.best.constants, rig.theta_start)
    detector = lifter_of(found.task, found.best.constants)
    timeout = max(LEAST_TIMEOUT, TIMEOUT * rig.dt)
    lifter: dict[str, Any] = {
        "cost": "raw" if model is None else "lifted",
        "omega_h": detector.omega_h,
        "omega_l": detector.omega_l,
        "y_out_max": float(f"{found.y_out_max:.3g}"),
        "dt": rig.dt,
        "state_timeout": timeout,
    }
    if model is not None:
        lifter["model"] = model.name  # beside the file: the folder may be moved
    lifter |= rig.lifter_input
    start = found.seen.scale.u(np.array(rig.theta_start))
    names = ("law", "theta_scale", "step_size", "step_ratio", "dwell", "tau_f", "theta_min",
             "theta_max", "rate_limit", "objective", "theta_initial", "dt")  # fmt: skip
    own = {name: getattr(esc, name) for name in names}
    own["epsilon_initial"] = 1 if start > found.seen.amplitude.best() else -1
    own["cost_timeout"] = timeout
    if not rig.takes_answers:
        own |= {
            "command_topic": rig.knob.topic,
            "command_type": rig.command_type,
            "command_field": format_field(rig.knob.fields[0]),
        }
    return {"koopman_lifter": lifter, "relay_esc": own}


def reasons_of(found: Tuning, rig: RigFile) -> dict[str, dict[str, str]]:
    """Return why each parameter is what it is."""
    c, time, period = found.best.constants, found.time, found.seen.period
    slow = time - 2.0 * period
    best = found.seen.scale.theta_at(found.seen.amplitude.best())
    searched = (
        f"the best of a search on the rig that the recording shows, whose oscillation has a period "
        f"of {period:.3g} s and whose amplitude follows theta within about {slow:.3g} s"
    )
    of_rig = "as the rig file says"
    timeout = f"{TIMEOUT:g} samples, at least {LEAST_TIMEOUT:g} s"
    return {
        "koopman_lifter": {
            "cost": found.why,
            "model": "learned from the excitation",
            "omega_h": f"{c.omega_h * period / (2 * math.pi):.3g} times the oscillation's "
            "frequency; " + searched,
            "omega_l": f"averages over {1.0 / c.omega_l:.3g} s, {1 / c.omega_l / period:.3g} "
            "periods; of the same search",
            "y_out_max": "ten times the largest of the recording",
            "dt": of_rig,
            "state_timeout": timeout,
            "input_fields": of_rig,
            "input_type": of_rig,
        },
        "relay_esc": {
            "law": "of the same search",
            "theta_scale": "theta's limits are a factor of "
            f"{rig.theta_max / rig.theta_min:.3g} apart" if found.task.any.logarithmic
            else "theta's limits are not far apart by a factor, or not above 0",
            "step_size": f"crosses the range in {1.0 / c.speed:.3g} s; within theta_rate",
            "step_ratio": "of the same search",
            "dwell": f"{c.dwell / time:.3g} times the rig's own time of {time:.3g} s",
            "tau_f": f"{c.tau_f / time:.3g} times the rig's own time",
            "theta_min": found.seen.limits.why_low or of_rig,
            "theta_max": found.seen.limits.why_high or of_rig,
            "rate_limit": "theta_rate of the rig file" + (
                " over theta_max: the rate of log theta" if found.task.any.logarithmic else ""),
            "objective": of_rig,
            "theta_initial": "theta_start of the rig file: no jump when the loop is closed",
            "epsilon_initial": f"towards {best:.4g}, where the recording is best",
            "dt": of_rig,
            "cost_timeout": timeout,
            "command_topic": of_rig,
            "command_type": of_rig,
            "command_field": of_rig,
        },
    }  # fmt: skip


def as_parameters(found: Tuning, rig: RigFile, model: Path | None) -> str:
    """Return the annotated parameter file."""
    nodes = ("koopman_lifter", "relay_esc", "recorder")
    text = parameter_file(
        {node: KNOWN[node] for node in nodes}, nodes_of(found, rig, model), reasons_of(found, rig)
    )
    return HEAD + text
