"""Command-line options that several commands share."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

from koop_core.config.parameter import ConfigError
from koop_loop import parameters
from koop_loop.parameters import NODES, LoopParameters
from koopman_lifter.config import SOURCES


def add_loop_options(parser: argparse.ArgumentParser, duration: float) -> None:
    """Add the options that choose an experiment: parameter file, cost, model, seed, duration."""
    parser.add_argument("--params-file", metavar="FILE", help="ROS 2 parameter file of the nodes")
    parser.add_argument(
        "--cost", type=_cost, metavar="{lifted,raw}", help="cost that the controller sees"
    )
    parser.add_argument("--model", metavar="FILE", help="Koopman model (default: the shipped one)")
    parser.add_argument("--seed", type=int, help="seed of the plant's initial state")
    parser.add_argument(
        "--duration",
        type=float,
        metavar="S",
        help=f"simulated time in seconds (default {duration:g}, as in the paper)",
    )
    parser.set_defaults(usual_duration=duration)


def _cost(text: str) -> str:
    """Return a cost that the lifter has; another one comes with a model."""
    if text not in SOURCES:
        hint = "lifted or raw"
        if text == "contrast":
            hint = "it comes with a model: koop train --contrast --out contrast.npz, then --model"
        raise argparse.ArgumentTypeError(f"'{text}' is not a cost of the lifter: {hint}")
    return text


def given_values(
    args: argparse.Namespace, nodes: Mapping[str, tuple[type, ...]] = NODES
) -> dict[str, dict[str, Any]]:
    """Return what the options of :func:`add_loop_options` and the parameter file say, by node.

    An option that is given wins over the file, the file over what the command does by default.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If the parameter file cannot be used.
    """
    values = parameters.read(args.params_file, nodes) if args.params_file else {}
    values = parameters.changed(
        values,
        ("koopman_lifter", "cost", args.cost),
        ("koopman_lifter", "model", args.model),
        ("vdp_plant", "seed", args.seed),
        ("vdp_plant", "duration", args.duration),
    )
    values.setdefault("vdp_plant", {}).setdefault("duration", args.usual_duration)
    return values


def loop_parameters(values: Mapping[str, Mapping[str, Any]]) -> LoopParameters:
    """Return the parameters of a run that has an end, from values by node.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If a value cannot be used, or the run has no two steps to judge.
    """
    made = parameters.make(values)
    if made.pace.duration < 2 * made.plant.dt:
        raise ConfigError("--duration must cover at least two steps")
    return made
