"""``koop bag metrics``: slow modules are imported where they are used."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from koop_bag.cli import bag_commands
from koop_lab.cli.source_options import add_namespace_option, add_reading_options, reading_of


def register(commands: Any) -> None:
    """Add `metrics` to ``koop bag``."""
    metrics = bag_commands(commands).add_parser("metrics", help="what a recorded run achieved")
    metrics.add_argument("run", type=Path, help="folder of a run or of a bag, or an .mcap file")
    add_namespace_option(metrics)
    metrics.add_argument(
        "--model",
        type=Path,
        metavar="FILE",
        help="r is computed under it; default: the recorded one",
    )
    metrics.add_argument(
        "--plot",
        type=Path,
        metavar="FILE",
        help="draw the run (png, svg, pdf)",
    )
    metrics.add_argument("--json", action="store_true", help="print all figures as JSON")
    add_reading_options(metrics.add_argument_group("a bag of other messages than the loop's"))
    metrics.set_defaults(func=_metrics)


def _metrics(args: argparse.Namespace) -> int:
    from koop_lab.recorded.report import costs_of, describe, figures, read

    run = read(args.run, reading_of(args), args.namespace, args.model, args.dt)
    if args.plot is not None:
        from koop_lab.plots.signals import plot_signals  # matplotlib takes half a second to import

        signals, costs = run.signals, costs_of(run, args.model)
        channels = dict(zip(signals.names, signals.measured.T, strict=True))
        thetas = {"theta": signals.theta} if signals.has_theta else {}
        title = str(args.run)
        plot_signals(args.plot, signals.t, channels, costs, thetas, title, run.theta_star)
    if args.json:
        print(json.dumps(figures(run), indent=1))
        return 0
    print(describe(run))
    if args.plot is not None:
        print(f"written to {args.plot}")
    return 0
