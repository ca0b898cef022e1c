"""``koop bag metrics`` and ``koop bag plot``: options only, so that ``koop bag`` stays quick."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from koop_bag.cli import bag_commands
from koop_lab.cli.source_options import add_reading_options


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
    parser.add_argument("--namespace", default="/", help="namespace of the loop")
    parser.add_argument(
        "--model",
        type=Path,
        metavar="FILE",
        help="r is computed under it; default: the recorded one",
    )
    add_reading_options(parser.add_argument_group("a bag of other messages than the loop's"))


def _metrics(args: argparse.Namespace) -> int:
    from koop_lab.recorded.report import metrics_main

    return metrics_main(args)


def _plot(args: argparse.Namespace) -> int:
    from koop_lab.recorded.report import plot_main

    return plot_main(args)
