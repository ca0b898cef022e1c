"""``koop train`` and ``koop inspect``: make a Koopman model, look at one."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from koop_lab import parameters
from koop_lab.table import mode_table
from koop_lab.train import TrainingConfig, train
from koopman_lifter.config import shipped_model
from koopman_lifter.model import KoopmanModel, load
from vdp_plant.config import PlantConfig


def register(commands: Any) -> None:
    """Add both commands to the subparsers of ``koop``."""
    default = TrainingConfig()
    parser = commands.add_parser("train", help="learn a Koopman model from simulated trajectories")
    parser.add_argument("--out", type=Path, default=Path("model.npz"), metavar="FILE.npz")
    parser.add_argument("--params", metavar="FILE", help="ROS 2 parameter file of the plant")
    parser.add_argument("--trajectories", type=int, default=default.trajectories)
    parser.add_argument("--duration", type=float, default=default.duration, metavar="S")
    parser.add_argument("--degree", type=int, default=default.degree)
    parser.add_argument("--modes", type=int, default=default.modes, metavar="N")
    parser.add_argument("--seed", type=int, default=default.seed)
    parser.add_argument("--integrator", choices=("rk4", "euler"))
    parser.add_argument("--clean", action="store_true", help="train without the interference")
    parser.set_defaults(func=train_main)

    parser = commands.add_parser("inspect", help="show a Koopman model")
    parser.add_argument("model", nargs="?", type=Path, help="model file (default: the shipped one)")
    parser.set_defaults(func=inspect_main)


def train_main(args: argparse.Namespace) -> int:
    """Entry point of ``koop train``; returns the exit code."""
    plant = parameters.make(parameters.read(args.params)).plant if args.params else PlantConfig()
    if args.integrator is not None:
        plant = replace(plant, integrator=args.integrator)
    config = TrainingConfig(
        trajectories=args.trajectories,
        duration=args.duration,
        degree=args.degree,
        modes=args.modes,
        corrupted=not args.clean,
        seed=args.seed,
    )
    model = train(plant, config)
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
    names = " ".join(model.observables.names(model.state_names))
    kept, asked = int(model.kept.sum()), model.provenance.get("modes_asked")
    lines = [
        f"model {model.model_id}, dt = {model.dt:g} s, states {', '.join(model.state_names)}",
        f"{model.observables.p} observables: {names}",
        "trained on " + ", ".join(f"{key} {value}" for key, value in model.provenance.items()),
        "",
        mode_table(model),
        "",
    ]
    if asked is not None and asked != kept:
        lines.append(f"{kept} modes kept where {asked} were asked for: no complex pair is split")
    else:
        lines.append(f"{kept} modes kept, by energy")
    return "\n".join(lines)
