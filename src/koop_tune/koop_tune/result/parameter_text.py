"""Annotated parameter files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from koop_bag.recorder.config import RECORDER
from koop_core.config.describe import parameter_file
from koop_core.config.parameter import refuse_unknown
from koop_guard.config import GUARD, RigLimits
from koop_loop.parameters import NODES, RIG
from koop_tune.rig.rig_file import RigFile
from relay_esc.config import EscConfig

Parameters = dict[str, tuple[Any, str]]  # value and reason by name
KNOWN = {**NODES, **GUARD, **RECORDER, **RIG}
OF_A_RIG = ("koopman_lifter", "relay_esc", "recorder", "rig")
OF_RIG = "as the rig file says"
DWELLS = 10.0  # in which a controller that nobody has tuned crosses theta's range, as the paper's
HEAD = """\
---
# Parameters of the nodes: each with its meaning, what it may be, and its default. Change what your
# rig needs; what you delete stays the default. dt must be the same in every section. A file that
# does not end with '...' is refused: it was cut off. Start with
#
#   ./koop up FILE
#   ros2 launch koop_bringup closed_loop.launch.py params:=FILE record:=true
#   ros2 run relay_esc esc --ros-args --params-file FILE
"""


def annotated(nodes: Iterable[str], listed: Mapping[str, Parameters]) -> str:
    """Return the file for some nodes; ``listed`` are the parameters that are not the defaults.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If there is no such node.
    """
    refuse_unknown(nodes, KNOWN, "node")
    values, reasons = (
        {
            node: {name: pair[i] for name, pair in parameters.items()}
            for node, parameters in listed.items()
        }
        for i in (0, 1)
    )
    return HEAD + parameter_file({node: KNOWN[node] for node in nodes}, values, reasons) + "...\n"


def list_lifter(rig: RigFile) -> Parameters:
    """Return the lifter's parameters that a rig file decides."""
    return {name: (value, OF_RIG) for name, value in rig.lifter_input.items()}


def list_guard(rig: RigFile, note: Path | None) -> Parameters:
    """Return the guard's parameters."""
    names = sorted(item.name for item in fields(RigLimits))
    parameters: Parameters = {name: (getattr(rig, name), OF_RIG) for name in names}
    if note is not None:
        parameters["note"] = (str(note.resolve()), "beside the rig file")
    return parameters


def list_untuned(rig: RigFile, note: Path) -> dict[str, Parameters]:
    """Return the parameters by node of a loop that nobody has tuned, as the rig file alone says.

    ``note`` is where theta's last value is noted.
    """
    knobs = zip(*map(rig.each, ("theta_min", "theta_max", "theta_rate")), strict=True)
    dwell = EscConfig().dwell
    crossing = DWELLS * dwell
    steps = tuple(min((high - low) / crossing, rate) * rig.dt for low, high, rate in knobs)
    return {
        "koopman_lifter": list_lifter(rig),
        "relay_esc": {
            "step_size": (
                steps if rig.count > 1 else steps[0],
                f"crosses the range in {DWELLS:g} times the dwell time of {dwell:g} s, or at "
                "theta_rate if that takes longer",
            ),
            "theta_min": (rig.theta_min, OF_RIG),
            "theta_max": (rig.theta_max, OF_RIG),
            "rate_limit": (rig.theta_rate, "theta_rate of the rig file"),
            "theta_initial": (rig.theta_safe, "theta_safe of the rig file: where the guard begins"),
            "objective": (rig.objective, OF_RIG),
            **({"constraint": (rig.theta_lines, OF_RIG)} if rig.lines else {}),
        },
        "koop_guard": list_guard(rig, note),
    }
