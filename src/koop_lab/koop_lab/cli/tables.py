"""Tables that the commands print: modes, metrics."""

from __future__ import annotations

import math
from collections.abc import Sequence

from koop_core.config.knobs import format_knobs
from koop_core.text_table import table
from koop_loop.metrics import PAPER, PAPER_DURATION, Metrics
from koop_loop.rig_metrics import RigMetrics
from koopman_lifter.model import KoopmanModel


def mode_table(model: KoopmanModel) -> str:
    """Return the modes as in table 2 of the paper, with their energies and residuals."""
    residuals = model.residuals
    rows = []
    for j, value in enumerate(model.eigenvalues):
        sign = "-" if value.imag < 0 else "+"
        rows.append(
            [
                f"{value.real:.6f} {sign} {abs(value.imag):.6f}j",
                f"{abs(value):.6f}",
                f"{model.energies[j]:.3e}",
                "-" if residuals is None else f"{residuals[j]:.2g}",
                "Yes" if model.kept[j] else "No",
            ]
        )
    return table(["eigenvalue", "|lambda|", "energy E_j", "residual", "selected"], rows)


def cost_name(cost: str, model: KoopmanModel | None) -> str:
    """Return what a cost is called: raw, lifted or, by the model's kind, contrast."""
    if cost == "raw" or model is None:
        return cost
    return str(model.provenance.get("variant", cost))


def metrics_table(metrics: Metrics, cost: str, duration: float) -> str:
    """Return the paper's metrics of a run of our plant.

    The paper's own (table 4) stand beside them where the run's duration [s] is the paper's.
    """
    paper = PAPER.get(cost, PAPER["lifted"])
    rows = [
        ["IAE_theta [s]", f"{metrics.iae_theta:.1f}", f"{paper.iae_theta:.1f}"],
        ["ISE_theta [s]", f"{metrics.ise_theta:.1f}", f"{paper.ise_theta:.1f}"],
        ["T_theta [s]", _known(metrics.t_theta, ".1f", absent="never"), f"{paper.t_theta:.0f}"],
        ["e_r_ss", _known(metrics.e_r_ss, ".5f"), f"{paper.e_r_ss:.5f}"],
        ["mean |theta - theta*|, last 30 %", f"{metrics.tail_error:.3f}", "-"],
    ]
    columns = [f"{cost} cost", "this run", "paper" + ", lifted" * (cost not in PAPER)]
    shown = 3 if math.isclose(duration, PAPER_DURATION, rel_tol=0.01) else 2
    return table(columns[:shown], [row[:shown] for row in rows])


def rig_table(metrics: RigMetrics, names: Sequence[str], grows: bool = False) -> str:
    """Return what a run says of a rig without a known optimum: amplitudes, theta.

    ``grows`` says that its amplitude is to be large.
    """
    change, unit = ("growth", -100.0) if grows else ("reduction", 100.0)
    rows = [
        [name, _known(before, ".4g"), _known(after, ".4g"), _known(unit * share, ".1f", " %")]
        for name, before, after, share in zip(
            names, metrics.before, metrics.after, metrics.reduction, strict=True
        )
    ]
    interference = any(name.startswith("true ") for name in names)
    lines = [
        table(["oscillation amplitude", "before", "after", change], rows),
        "as measured, with the interference"
        + ("; 'true': without it" if interference else ", which 'koop verify' leaves out"),
        "sqrt(2) times the standard deviation about a straight line, in windows of "
        f"{metrics.window:g} s; before: {metrics.before_from:g} to {metrics.before_to:g} s, "
        f"after: {metrics.after_from:g} to {metrics.after_to:g} s",
        "",
    ]
    if metrics.theta_mean is None:
        return "\n".join([*lines, "theta at the end: not recorded, or held by the guard"])
    settled = metrics.settled_at
    lines.append(
        "theta has not settled: it came into its final swing only at the end"
        if settled is None
        else f"theta has settled: within its final swing from {settled:.1f} s on"
    )
    limit = metrics.at_limit
    lines.append(
        f"theta at the end: mean {format_knobs(metrics.theta_mean, '.4g')}, swing "
        f"{format_knobs(metrics.theta_swing or (), '.4g')} "
        "(largest minus least); at a limit for "
        + ("an unknown share of the time" if limit is None else f"{100.0 * limit:.1f} % of the run")
    )
    return "\n".join(lines)


def _known(value: float | None, form: str, unit: str = "", absent: str = "-") -> str:
    return absent if value is None or math.isnan(value) else f"{value:{form}}{unit}"
