"""Annotated parameter files."""

from __future__ import annotations

from collections.abc import Iterable

from koop_bag.recorder.config import RECORDER
from koop_core.config.describe import parameter_file
from koop_core.config.parameter import refuse_unknown
from koop_guard.config import GUARD
from koop_loop.parameters import NODES
from koop_loop.rig_program import RIG

KNOWN = {**NODES, **GUARD, **RECORDER, **RIG}
OF_A_RIG = ("koopman_lifter", "relay_esc", "recorder", "rig")
HEAD = """\
# Parameters of the nodes: each with its meaning, what it may be, and its default. Change what your
# rig needs; what you delete stays the default. dt must be the same in every section. Start with
#
#   ./koop up FILE
#   ros2 launch koop_bringup closed_loop.launch.py params:=FILE record:=true
#   ros2 run relay_esc esc --ros-args --params-file FILE
"""


def annotated(nodes: Iterable[str]) -> str:
    """Return the file for some nodes.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If there is no such node.
    """
    refuse_unknown(nodes, KNOWN, "node")
    return HEAD + parameter_file({node: KNOWN[node] for node in nodes})
