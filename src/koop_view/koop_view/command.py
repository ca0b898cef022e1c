"""``koop serve``: a page that shows a running loop or a recorded run."""

from __future__ import annotations

import argparse
import asyncio
from typing import Any

from koop_core.config.parameter import ConfigError
from koop_view.config import ViewConfig


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    default = ViewConfig()
    parser = commands.add_parser(
        "serve",
        description="Serves a page that shows the loops of the ROS domain, or a recorded run, and "
        "the Foxglove WebSocket protocol on the same port, for Foxglove, Lichtblick and others.",
    )
    parser.add_argument(
        "run", metavar="RUN", nargs="?",
        help="run folder, bag or .mcap file (default: the loops of the ROS domain)",
    )  # fmt: skip
    parser.add_argument(
        "--operate", action="store_true",
        help="print an address with which the loop may be held, reset and changed",
    )  # fmt: skip
    parser.add_argument(
        "--port", type=int, metavar="N", default=default.port,
        help=f"TCP port (default: {default.port})",
    )  # fmt: skip
    parser.add_argument(
        "--host", metavar="ADDRESS", default=default.host,
        help=f"address to listen on (default: {default.host}, which only this machine reaches)",
    )  # fmt: skip
    parser.add_argument(
        "--allow-origin", metavar="ORIGIN", action="append", default=[],
        help="let the web pages of another server connect, such as https://app.foxglove.dev",
    )  # fmt: skip
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code."""
    config = ViewConfig(args.host, args.port, args.operate, tuple(args.allow_origin))
    if args.run is None:
        from koop_view.node import run  # imports rclpy

        return run(config)
    if config.operate:
        raise ConfigError("--operate: a recording cannot be operated")
    from koop_view.recorded import RecordedSource
    from koop_view.serving import serve

    asyncio.run(serve(RecordedSource(args.run), config))
    return 0
