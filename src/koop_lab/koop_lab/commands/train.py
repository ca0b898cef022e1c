"""``koop train`` and ``koop inspect``: make a Koopman model, look at one."""

from __future__ import annotations

import argparse
import sys
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from koop_bag.mcap.stored_file import stored_path, traffic
from koop_identify.model.from_bags import BagTraining, train_from_bags
from koop_identify.recording.samples import StateSpec
from koop_identify.recording.segments import WAYS
from koop_lab.cli.source_options import add_source_options, source_of
from koop_lab.cli.tables import forecast_table, mode_table
from koop_loop import parameters
from koop_loop.training import STATE_NAMES, TrainingConfig, train
from koopman_lifter.bootstrap import RESAMPLES
from koopman_lifter.config import shipped_model
from koopman_lifter.delays import Delays, embedded_degree
from koopman_lifter.estimators import ESTIMATORS
from koopman_lifter.fit import Fit
from koopman_lifter.model import KoopmanModel, load
from koopman_lifter.modes import SELECTIONS
from vdp_plant.config import PlantConfig

SIMULATION = (
    "params_file", "trajectories", "duration", "seed", "integrator", "no_interference"
)  # fmt: skip
BAGS = ("state", "theta", "names", "dt", "way", "gap", "held_out", "horizons")


def register(commands: Any) -> None:
    """Add both commands to the subparsers of ``koop``."""
    default = TrainingConfig()
    parser = commands.add_parser("train")
    parser.add_argument(
        "bags",
        nargs="*",
        metavar="BAG",
        help="recordings to learn from; also URLs, such as s3://BUCKET/RUN",
    )
    parser.add_argument("--out", type=Path, default=Path("model.npz"), metavar="FILE.npz")
    parser.add_argument(
        "--degree",
        type=int,
        help="largest degree of the monomials (default 3; with delays the "
        "largest of 3, 2, 1 that has at most 120 observables)",
    )
    parser.add_argument(
        "--delays", type=int, default=1, metavar="D",
        help="the state is the last D samples of every channel: for a rig of which one signal is "
        "measured, or channels that lag (8 is a good start)",
    )  # fmt: skip
    parser.add_argument(
        "--spacing", type=float, metavar="S",
        help="time between two of these samples (default: together they span an eighth of the "
        "period of the strongest oscillation)",
    )  # fmt: skip
    parser.add_argument("--modes", type=int, default=default.modes, metavar="N")
    parser.add_argument(
        "--contrast",
        action="store_true",
        help="in place of the most energetic modes, the direction in which strongly oscillating "
        "parts of the data differ most from weakly oscillating ones (the study's best cost)",
    )
    _add_fit_options(parser)
    parser.add_argument(
        "--compare",
        action="store_true",
        help="train nothing, but say how well each kind of cost would tell the oscillation of "
        "these bags, and draw it beside --out",
    )
    _add_bag_options(parser.add_argument_group("from bags"))
    group = parser.add_argument_group("without a bag: the simulated plant")
    group.add_argument("--params-file", metavar="FILE", help="ROS 2 parameter file of the plant")
    group.add_argument("--trajectories", type=int, help=f"default {default.trajectories}")
    group.add_argument("--duration", type=float, metavar="S", help=f"default {default.duration:g}")
    group.add_argument("--seed", type=int, help=f"default {default.seed}")
    group.add_argument("--integrator", choices=("rk4", "euler"))
    group.add_argument(
        "--no-interference",
        action="store_const",
        const=True,
        help="train on the true states",
    )
    parser.set_defaults(func=train_main)

    parser = commands.add_parser("inspect")
    parser.add_argument("model", nargs="?", type=Path, help="model file (default: the shipped one)")
    parser.add_argument(
        "bag", nargs="?", type=Path,
        help="a recording: how the model does on it, as a forecast and as a cost",
    )  # fmt: skip
    parser.add_argument("--namespace", default="/", help="namespace of the loop")
    parser.add_argument("--params-file", metavar="FILE", help="settings of detector and relay")
    parser.add_argument(
        "--set", action="append", default=[], metavar="NODE.PARAMETER=VALUE", dest="settings",
        help="one setting, such as koopman_lifter.omega_h=100; may be repeated",
    )  # fmt: skip
    add_source_options(parser)
    parser.set_defaults(func=inspect_main)


def _add_fit_options(parser: Any) -> None:
    default = Fit()
    parser.add_argument(
        "--estimator",
        choices=tuple(ESTIMATORS),
        default=default.estimator,
        help="of K: least squares, as the paper, sees damping that is not there where the "
        "measurements are noisy; the other two do not (docs/explanation/theory.md)",
    )
    parser.add_argument(
        "--select",
        choices=SELECTIONS,
        default=default.select,
        help="which N modes are kept: those of largest energy, as the paper; of smallest residual; "
        "or 'trusted', of largest energy among those with a residual of at most --residual-limit",
    )
    parser.add_argument(
        "--residual-limit", type=float, default=default.residual_limit, metavar="X",
        help=f"with --select trusted (default {default.residual_limit:g})",
    )  # fmt: skip
    parser.add_argument(
        "--resamples", type=int, default=RESAMPLES, metavar="N",
        help=f"data sets drawn for the spread of the eigenvalues (default {RESAMPLES}; 0: none)",
    )  # fmt: skip


def _fit(args: argparse.Namespace) -> Fit:
    return Fit(**{field.name: getattr(args, field.name) for field in fields(Fit)})


def _add_bag_options(group: Any) -> None:
    group.add_argument(
        "--state",
        metavar="/TOPIC:FIELDS",
        help="numeric fields, such as /joint_states:position[0],velocity[0] (default /state:x)",
    )
    group.add_argument(
        "--theta",
        metavar="/TOPIC:FIELD",
        help="the knob, for --contrast: which parts oscillate strongly is then told by theta "
        "(default /theta:theta if the bag has it)",
    )
    group.add_argument("--names", metavar="A,B", help="names of the states")
    group.add_argument("--dt", type=float, metavar="S", help="default: the recorded loop's")
    group.add_argument(
        "--resample",
        dest="way",
        choices=("auto", *WAYS),
        help="from messages to states one dt apart: 'steps' as they are, neighbours by their field "
        "step; 'linear' between stamps; 'zoh' the last message before; 'none' as they are, without "
        "a look at the time. Messages without stamps are counted, as the lifter does. Default "
        "auto: steps where they fit, else linear",
    )
    group.add_argument(
        "--gap", type=float, metavar="S",
        help="longest pause that is bridged (default: 3 usual periods, at least 3 dt; 'none' and "
        "'steps' do not use it)",
    )  # fmt: skip
    group.add_argument(
        "--held-out", type=float, metavar="SHARE",
        help="share of the data that is only tested on (default 0.2)",
    )  # fmt: skip
    group.add_argument(
        "--horizons", metavar="N,N", help="steps ahead of the test (default 1,10,50,200)"
    )


def train_main(args: argparse.Namespace) -> int:
    """Entry point of ``koop train``; returns the exit code."""
    unfit = [
        name for name in (SIMULATION if args.bags else BAGS) if getattr(args, name) is not None
    ]
    if unfit:
        option = "resample" if unfit[0] == "way" else unfit[0].replace("_", "-")
        raise ValueError(
            f"--{option} is for training {'without a bag' if args.bags else 'on bags'}"
        )
    args.bags = [stored_path(bag) for bag in args.bags]
    if args.compare:
        return _compare(args)
    model = train_from_bags(args.bags, _bag_training(args)) if args.bags else _simulated(args)
    model.save(args.out)
    print(describe(model))
    print(f"written to {args.out}")
    for line in traffic():
        print(line, file=sys.stderr)
    return 0


def _compare(args: argparse.Namespace) -> int:
    from koop_identify.model.compare import (  # draws, which is slow to import
        compare,
        described,
        draw,
    )

    if not args.bags:
        raise ValueError("--compare needs bags: the recordings to judge the costs by")
    found = compare(args.bags, _bag_training(args))
    print(described(found))
    figure = args.out.with_suffix(".png")
    draw(found, figure, ", ".join(path.name for path in args.bags))
    print(f"figure {figure}")
    return 0


def _bag_training(args: argparse.Namespace) -> BagTraining:
    given: dict[str, Any] = {
        name: getattr(args, name)
        for name in ("dt", "way", "gap", "held_out", "degree", "spacing", "theta")
        if getattr(args, name) is not None
    }
    if args.horizons is not None:
        try:
            given["horizons"] = tuple(int(text) for text in args.horizons.split(","))
        except ValueError:
            raise ValueError(f"--horizons {args.horizons}: write steps, such as 1,10,50") from None
    if args.names is not None:
        given["names"] = tuple(args.names.split(","))
    state = StateSpec.parse(args.state or "/state:x")
    return BagTraining(
        state,
        modes=args.modes,
        contrast=args.contrast,
        delays=args.delays,
        fit=_fit(args),
        **given,
    )


def _simulated(args: argparse.Namespace) -> KoopmanModel:
    plant = PlantConfig()
    if args.params_file:
        plant = parameters.make(parameters.read(args.params_file)).plant
    if args.integrator is not None:
        plant = replace(plant, integrator=args.integrator)
    given = {
        name: getattr(args, name)
        for name in ("trajectories", "duration", "seed")
        if getattr(args, name) is not None
    }
    n = len(STATE_NAMES)
    degree = args.degree
    if degree is None:
        degree = embedded_degree(n * args.delays) if args.delays > 1 else TrainingConfig.degree
    config = TrainingConfig(
        degree=degree, modes=args.modes, corrupted=not args.no_interference, **given
    )
    if args.delays > 1 and args.spacing is None:
        raise ValueError("--delays without a bag needs --spacing: no recording tells a period")
    delays = Delays.spaced(n, args.delays, args.spacing or 0.0, plant.dt)
    return train(plant, config, args.contrast, delays, _fit(args))


def inspect_main(args: argparse.Namespace) -> int:
    """Entry point of ``koop inspect``; returns the exit code."""
    path = args.model or shipped_model()
    model = load(path)
    print(f"{path}\n{describe(model)}")
    if args.bag is not None:
        from koop_lab.recorded.inspection import inspect_on  # SciPy's statistics are slow to import

        print("\n" + inspect_on(args.bag, path, model, source_of(args), args))
    return 0


def describe(model: KoopmanModel) -> str:
    """Return a model in words: identity, observables, training data, modes."""
    delays = model.delays
    names = " ".join(model.observables.names(delays.names(model.state_names, model.dt)))
    kept, asked = int(model.kept.sum()), model.provenance.get("modes_asked")
    lines = [
        f"model {model.model_id}, dt = {model.dt:g} s, states {', '.join(model.state_names)}",
        f"{model.observables.p} observables: {names}",
        *(
            [
                f"state: the last {delays.count} samples of each, {delays.every * model.dt:g} s "
                f"apart; no cost for {(delays.depth - 1) * model.dt:g} s after a start"
            ]
            if delays.count > 1
            else []
        ),
        *origin(model.provenance),
        "",
        mode_table(model),
        "",
    ]
    variant = model.provenance.get("variant", "lifted")
    if variant != "lifted":
        lines.append(
            f"cost: {variant}. It is not the energy of these modes but of one direction of the "
            "state: the one in which strong and weak oscillation differ most (see docs/explanation)"
        )
    else:
        lines.append(
            f"cost: lifted, the energy of the {kept} mode{'s' * (kept > 1)} kept, "
            f"{_selection(model.provenance)}"
        )
        if asked is not None and asked < kept:
            lines[-1] += f"; {asked} were asked for, but no complex pair is split"
        elif asked is not None and asked > kept:
            lines[-1] += f"; {asked} were asked for"
    lines += _worth(model)
    if model.provenance.get("forecast"):
        lines += ["", forecast_table(model)]
    return "\n".join(lines)


def _selection(provenance: dict[str, Any]) -> str:
    """Return in words how the kept modes were chosen."""
    by = provenance.get("select", "energy")
    if by != "trusted":
        return f"by {by}"
    limit = provenance.get("residual_limit", Fit().residual_limit)
    return f"by energy among those with a residual of at most {limit:g}"


def _worth(model: KoopmanModel) -> list[str]:
    """Return what the columns of the mode table that tell the modes' worth mean."""
    if model.residuals is None:
        return [
            "residuals and spread are not known: the file is of version 1, 'koop train' has both"
        ]
    lines = ["residual: relative error of the mode over one step, 0 for a mode of the system"]
    if model.spread is not None:
        lines.append("spread: standard deviation of the eigenvalue over stretches of the data")
    elif model.provenance.get("resamples"):
        lines.append("spread: not known, the data are too few or too short stretches")
    return lines


def origin(provenance: dict[str, Any]) -> list[str]:
    """Return in words what a model was trained on."""
    plain = {k: v for k, v in sorted(provenance.items()) if not isinstance(v, list)}
    lines = ["trained on " + ", ".join(f"{key} {value}" for key, value in plain.items())]
    for bag in provenance.get("bags", []):
        lines.append(f"  {bag['name']} ({bag['sha256'][:12]}): {_recorded(bag)}")
    return lines


def _recorded(bag: dict[str, Any]) -> str:
    """Return in words how the samples of a bag became segments."""
    samples = bag["states"] if "used" not in bag else f"{bag['used']} of {bag['states']}"
    words = f"{samples} samples in {bag['segments']} segments, {bag['pairs']} pairs ({bag['way']}"
    if bag.get("counted_period"):
        words += f"; no stamps: counted, one each {bag['counted_period']:.4g} s"
    if "gaps" in bag and bag["way"] != "none":
        longer = "" if bag["way"] == "steps" else f" longer than {bag['gap']:.4g} s"
        words += f"; gaps{longer}: {bag['gaps']}"
    return words + ")" + (f", {bag['not_finite']} not finite" if bag["not_finite"] else "")
