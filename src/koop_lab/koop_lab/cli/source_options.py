"""Options that say where state and theta are in a bag; light, so that ``koop bag`` stays quick."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from koop_identify.recording.signals import Source

WAYS = ("auto", "steps", "linear", "zoh", "none")


def add_source_options(parser: Any) -> None:
    """Add --state, --theta and how messages become states."""
    group = parser.add_argument_group("a bag of other messages than the loop's")
    group.add_argument(
        "--state",
        metavar="/TOPIC:FIELDS",
        help="numeric fields, such as /joint_states:position[0],velocity[0]",
    )
    group.add_argument(
        "--theta", metavar="/TOPIC:FIELD", help="the control input, such as /rig/theta:data"
    )
    group.add_argument("--dt", type=float, metavar="S", help="default: the model's or the loop's")
    group.add_argument(
        "--resample", dest="way", choices=WAYS, default="auto",
        help="from messages to states, as in koop train",
    )  # fmt: skip
    group.add_argument(
        "--gap", type=float, metavar="S", help="longest pause that is bridged, as in koop train"
    )


def source_of(args: argparse.Namespace) -> Source:
    """Return what the options of :func:`add_source_options` say.

    Raises
    ------
    ValueError
        If a source cannot be read, or an option has no effect without another.
    """
    from koop_identify.recording.samples import StateSpec
    from koop_identify.recording.signals import Source

    if args.state is None:
        for name, given in (
            ("theta", args.theta), ("gap", args.gap),
            ("resample", None if args.way == "auto" else args.way),
        ):  # fmt: skip
            if given is not None:
                raise ValueError(f"--{name} needs --state: which fields are the state")
    return Source(
        StateSpec.parse(args.state) if args.state else None,
        StateSpec.parse(args.theta) if args.theta else None,
        getattr(args, "namespace", "/"),
        args.dt,
        args.way,
        args.gap,
    )
