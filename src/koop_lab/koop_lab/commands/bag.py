"""``koop bag metrics`` and ``koop bag plot``: slow modules are imported where they are used."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from koop_bag.cli import bag_commands
from koop_lab.cli.source_options import add_namespace_option, add_reading_options, reading_of


def register(commands: Any) -> None:
    """Add `metrics` and `plot` to ``koop bag``."""
    bag = bag_commands(commands)
    metrics = bag.add_parser("metrics", help="what a recorded run achieved")
    _add_run_options(metrics)
    metrics.add_argument("--json", action="store_true", help="print all figures as JSON")
    metrics.add_argument(
        "--start", type=float, metavar="S",
        help="leave out what is before, but for the paper's metrics, which begin at 100 s",
    )  # fmt: skip
    metrics.set_defaults(func=_metrics)

    plot = bag.add_parser(
        "plot",
        help="a page: signals over time, spectra, the model's modes",
    )
    _add_run_options(plot)
    text = "png, svg or pdf (default: report.png in RUN)"
    plot.add_argument("--out", type=Path, metavar="FILE", help=text)
    plot.set_defaults(func=_plot)


def _add_run_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", type=Path, help="folder of a run or of a bag, or an .mcap file")
    add_namespace_option(parser)
    parser.add_argument(
        "--model",
        type=Path,
        metavar="FILE",
        help="r is computed under it; default: the recorded one",
    )
    add_reading_options(parser.add_argument_group("a bag of other messages than the loop's"))


def _metrics(args: argparse.Namespace) -> int:
    from koop_lab.recorded.report import describe, figures, read

    run = read(args.run, reading_of(args), args.namespace, args.model, args.dt)
    print(
        json.dumps(figures(run, args.start), indent=1) if args.json else describe(run, args.start)
    )
    return 0


def _plot(args: argparse.Namespace) -> int:
    from koop_lab.plots.report import plot_report  # matplotlib takes half a second to import
    from koop_lab.recorded.report import costs_of, describe_coverage, read

    run = read(args.run, reading_of(args), args.namespace, args.model, args.dt)
    out = args.out or (args.run if args.run.is_dir() else args.run.parent) / "report.png"
    costs = costs_of(run, args.model)
    plot_report(out, run.signals, costs, run.model, run.theta_star, f"{args.run}")
    print(f"written to {out}")
    print(describe_coverage(run))
    return 0
