"""``koop bag metrics`` and ``koop bag plot``: options only, so that ``koop bag`` stays quick."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from koop_bag.cli import bag_commands


def register(commands: Any) -> None:
    """Add `metrics` and `plot` to ``koop bag``."""
    bag = bag_commands(commands)
    metrics = bag.add_parser("metrics", help="the paper's metrics of a recorded run")
    _add_run_options(metrics)
    metrics.add_argument("--json", action="store_true", help="print JSON")
    metrics.set_defaults(func=_metrics)

    plot = bag.add_parser(
        "plot", help="state, cost, theta, spectrogram and the model's eigenvalues"
    )
    _add_run_options(plot)
    text = "png, svg or pdf (default: report.png in RUN)"
    plot.add_argument("--out", type=Path, metavar="FILE", help=text)
    plot.set_defaults(func=_plot)


def _add_run_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", type=Path, help="folder of a run or of a bag, or an .mcap file")
    parser.add_argument("--namespace", default="/", help="namespace of the loop")
    parser.add_argument("--model", type=Path, metavar="FILE", help="if it is not in the folder")
    text = "the best theta, if you know it"
    parser.add_argument("--theta-star", type=float, metavar="THETA", help=text)


def _metrics(args: argparse.Namespace) -> int:
    from koop_lab.recorded.report import metrics_main

    return metrics_main(args)


def _plot(args: argparse.Namespace) -> int:
    from koop_lab.recorded.report import plot_main

    return plot_main(args)
