"""``koop train`` and ``koop inspect``: make a Koopman model, look at one."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from koop_bag.mcap.stored_file import stored_path
from koop_core.errors import InputError
from koop_identify.model.from_bags import BagTraining, train_from_bags
from koop_lab.cli.source_options import add_reading_options, reading_of
from koop_lab.cli.tables import mode_table
from koop_loop.training import TrainingConfig, train
from koopman_lifter.config import shipped_model
from koopman_lifter.model import KoopmanModel, load
from vdp_plant.config import PlantConfig

BAGS = ("measured", "commanded", "dt", "gap", "delays")
LOOP_STATE = "/state:x"


def register(commands: Any) -> None:
    """Add both commands to the subparsers of ``koop``."""
    default = TrainingConfig()
    parser = commands.add_parser("train")
    parser.add_argument(
        "bags",
        nargs="*",
        metavar="BAG",
        help="recordings to learn from; also URLs, such as s3://BUCKET/RUN (none: the simulated "
        "plant is learned)",
    )
    parser.add_argument("--out", type=Path, default=Path("model.npz"), metavar="FILE.npz")
    parser.add_argument(
        "--degree",
        type=int,
        help="largest degree of the monomials (default 3; with delays the "
        "largest of 3, 2, 1 that has at most 120 observables)",
    )
    parser.add_argument("--modes", type=int, default=default.modes, metavar="N")
    parser.add_argument(
        "--contrast",
        action="store_true",
        help="in place of the most energetic modes, the direction in which strongly oscillating "
        "parts of the data differ most from weakly oscillating ones (the study's best cost)",
    )
    group = parser.add_argument_group("from bags")
    group.add_argument(
        "--delays", type=int, metavar="D",
        help="the state is the last D samples of every channel, which span an eighth of the "
        "strongest oscillation's period: for a rig of which one signal is measured, or channels "
        "that lag (8 is a good start)",
    )  # fmt: skip
    add_reading_options(group)
    parser.set_defaults(func=train_main)

    parser = commands.add_parser("inspect")
    parser.add_argument("model", nargs="?", type=Path, help="model file (default: the shipped one)")
    parser.set_defaults(func=inspect_main)


def train_main(args: argparse.Namespace) -> int:
    """Entry point of ``koop train``; returns the exit code."""
    if not args.bags and any(getattr(args, name) is not None for name in BAGS):
        raise InputError("--measured, --command, --dt, --gap, --delays are for training on bags")
    if args.bags:
        reading = reading_of(args, LOOP_STATE)
        assert reading is not None
        training = BagTraining(
            reading,
            degree=args.degree,
            modes=args.modes,
            contrast=args.contrast,
            delays=1 if args.delays is None else args.delays,
        )
        model = train_from_bags([stored_path(bag) for bag in args.bags], training)
    else:
        config = TrainingConfig(modes=args.modes)
        if args.degree is not None:
            config = replace(config, degree=args.degree)
        model = train(PlantConfig(), config, args.contrast)
    model.save(args.out)
    print(describe(model))
    print(f"written to {args.out}")
    return 0


def inspect_main(args: argparse.Namespace) -> int:
    """Entry point of ``koop inspect``; returns the exit code."""
    path = args.model or shipped_model()
    print(f"{path}\n{describe(load(path))}")
    return 0


def describe(model: KoopmanModel) -> str:
    """Return a model in words: identity, observables, training data, modes."""
    delays = model.delays
    names = " ".join(model.observables.names(delays.names(model.state_names, model.dt)))
    lines = [
        f"model {model.model_id}, dt = {model.dt:g} s, states {', '.join(model.state_names)}",
        f"{model.observables.p} observables: {names}",
    ]
    if delays.count > 1:
        lines.append(
            f"state: the last {delays.count} samples of each, {delays.every * model.dt:g} s "
            f"apart; no cost for {(delays.depth - 1) * model.dt:g} s after a start"
        )
    lines += [*origin(model.provenance), "", mode_table(model), "", _cost(model)]
    if model.residuals is None:
        lines.append("residuals are not known: the file has none")
    else:
        lines.append("residual: relative error of the mode over one step, 0 for a mode of the rig")
    return "\n".join(lines)


def _cost(model: KoopmanModel) -> str:
    """Return in words what the cost of a model is the energy of."""
    variant = model.provenance.get("variant", "lifted")
    if variant != "lifted":
        return (
            f"cost: {variant}. It is not the energy of these modes but of one direction of the "
            "state: the one in which strong and weak oscillation differ most "
            "(docs/explanation/theory.md)"
        )
    kept = int(model.kept.sum())
    return (
        f"cost: lifted, the energy of the {kept} mode{'s' * (kept > 1)} kept, by energy (no "
        "complex pair is split)"
    )


def origin(provenance: dict[str, Any]) -> list[str]:
    """Return in words what a model was trained on."""
    plain = {k: v for k, v in sorted(provenance.items()) if not isinstance(v, list)}
    lines = ["trained on " + ", ".join(f"{key} {value}" for key, value in plain.items())]
    for bag in provenance.get("bags", []):
        lines.append(f"  {bag['name']} ({bag['sha256'][:12]}): {_recorded(bag)}")
    return lines


def _recorded(bag: dict[str, Any]) -> str:
    """Return in words how the samples of a bag became segments."""
    words = (
        f"{bag['states']} samples in {bag['segments']} segments, {bag['pairs']} pairs ({bag['way']}"
    )
    if bag.get("counted_period"):
        words += f"; no stamps: counted, one each {bag['counted_period']:.4g} s"
    if "gaps" in bag:
        longer = "" if bag["way"] == "steps" else f" longer than {bag['gap']:.4g} s"
        words += f"; gaps{longer}: {bag['gaps']}"
    return words + ")" + (f", {bag['not_finite']} not finite" if bag["not_finite"] else "")
