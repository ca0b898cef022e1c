"""Measured and commanded fields of a bag, as options; light, so that ``koop bag`` is quick."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from koop_core.errors import InputError

if TYPE_CHECKING:
    from koop_identify.recording.segmentation import BagReading


def add_reading_options(parser: Any) -> None:
    """Add --measured, --command and how messages become states."""
    parser.add_argument(
        "--measured",
        metavar="/TOPIC:FIELDS",
        help="numeric fields, such as /joint_states:position[0],velocity[0] (default: the loop's)",
    )
    parser.add_argument(
        "--command",
        dest="commanded",  # 'command' is the name of the command itself
        metavar="/TOPIC:FIELD",
        help="the control input theta, such as /rig/theta:data (default: the loop's)",
    )
    parser.add_argument(
        "--dt", type=float, metavar="S",
        help="time between two states (default: the model's, the loop's or the messages')",
    )  # fmt: skip
    parser.add_argument(
        "--gap", type=float, metavar="S",
        help="longest pause that is bridged (default: 3 usual periods, but no missing step)",
    )  # fmt: skip


def add_namespace_option(parser: Any) -> None:
    """Add --namespace; ``two``, ``/two`` and ``/two/`` are alike, as for ROS 2's own commands."""
    parser.add_argument(
        "--namespace", type=lambda text: f"/{text.strip('/')}", default="/",
        help="namespace of the recorded loop",
    )  # fmt: skip


def reading_of(args: argparse.Namespace, default: str = "") -> BagReading | None:
    """Return what the options of :func:`add_reading_options` say; None: the loop's own topics.

    ``default`` is measured where ``--measured`` is not given.

    Raises
    ------
    koop_core.errors.InputError
        If a source cannot be read, or an option has no effect without another.
    """
    from koop_identify.recording.samples import recorded_source
    from koop_identify.recording.segmentation import BagReading

    if not (measured := args.measured or default):
        for name, value in (("command", args.commanded), ("gap", args.gap)):
            if value is not None:
                raise InputError(f"--{name} needs --measured: which fields are the state")
        if args.dt is not None and not 0.0 < args.dt < 1e6:
            raise InputError(f"--dt {args.dt:g}: must be positive")
        return None
    commands = (recorded_source(args.commanded),) if args.commanded else ()
    return BagReading(recorded_source(measured), commands, args.dt, args.gap)
