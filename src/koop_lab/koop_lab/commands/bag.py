"""``koop bag metrics`` and ``koop bag plot``: options only, so that ``koop bag`` stays quick."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from koop_bag.cli import bag_commands
from koop_lab.cli.source_options import add_source_options


def register(commands: Any) -> None:
    """Add `metrics` and `plot` to ``koop bag``."""
    bag = bag_commands(commands)
    metrics = bag.add_parser("metrics", help="what a recorded run achieved")
    _add_run_options(metrics)
    metrics.add_argument("--json", action="store_true", help="print all figures as JSON")
    metrics.add_argument(
        "--window", type=float, metavar="S",
        help="of the amplitudes (default: five periods of the strongest oscillation)",
    )  # fmt: skip
    metrics.add_argument(
        "--start", type=float, metavar="S",
        help="leave out what is before (default: nothing; of the paper's metrics 100 s)",
    )  # fmt: skip
    metrics.add_argument(
        "--tolerance", type=float, metavar="THETA",
        help="|theta - theta*| that counts as reached (default 0.1)",
    )  # fmt: skip
    metrics.add_argument(
        "--limits", type=_limits, metavar="LOW,HIGH",
        help="of theta, where the bag does not say when it was at one (write --limits=-5,5)",
    )  # fmt: skip
    metrics.set_defaults(func=_metrics)

    plot = bag.add_parser(
        "plot",
        help="a page: signals, spectra, the model's modes, cost and oscillation against theta",
    )
    _add_run_options(plot)
    plot.add_argument("--params-file", metavar="FILE", help="settings under which r is computed")
    plot.add_argument(
        "--set", action="append", default=[], metavar="NODE.PARAMETER=VALUE", dest="settings",
        help="one setting, such as koopman_lifter.omega_h=100; may be repeated",
    )  # fmt: skip
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
    text = "the best theta, if you know it: adds the paper's metrics"
    parser.add_argument("--theta-star", type=float, metavar="THETA", help=text)
    add_source_options(parser)


def _limits(text: str) -> tuple[float, float]:
    try:
        low, high = map(float, text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text}: write LOW,HIGH, such as -5,5") from None
    if not low < high:
        raise argparse.ArgumentTypeError(f"{text}: the first must be below the second")
    return low, high


def _metrics(args: argparse.Namespace) -> int:
    from koop_lab.recorded.report import metrics_main

    return metrics_main(args)


def _plot(args: argparse.Namespace) -> int:
    from koop_lab.recorded.report import plot_main

    return plot_main(args)
