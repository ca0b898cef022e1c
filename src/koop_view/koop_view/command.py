"""``koop serve``: a page that shows a running loop or a recorded run."""

from __future__ import annotations

import argparse
import asyncio
from dataclasses import asdict, fields
from typing import Any

from koop_view.config import ViewConfig


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser(
        "serve",
        description="Serves a page that shows the loops of the ROS domain, or a recorded run, and "
        "the Foxglove WebSocket protocol on the same port, for Foxglove, Lichtblick and others.",
    )
    parser.add_argument(
        "run", metavar="RUN", nargs="?",
        help="run folder, bag or .mcap file (default: what runs in the ROS domain)",
    )  # fmt: skip
    parser.add_argument(
        "--operate",
        action="store_true",
        help="let whoever has the printed address hold, reset and change the loop",
    )
    parser.add_argument("--port", type=int, metavar="N", help="TCP port (default: 8765)")
    parser.add_argument(
        "--host", metavar="ADDRESS",
        help="address to listen on (default: 127.0.0.1, which only this machine reaches)",
    )  # fmt: skip
    parser.add_argument(
        "--allow-origin", metavar="ORIGIN", action="append", default=[], dest="allow_origins",
        help="let the web pages of another server connect, such as https://app.foxglove.dev",
    )  # fmt: skip
    parser.add_argument(
        "--about", metavar="FILE",
        help="show the line in this file beside the loop; it may change",
    )  # fmt: skip
    parser.set_defaults(func=main)


def chosen(args: argparse.Namespace) -> ViewConfig:
    """Return what the options say.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If one cannot be used.
    """
    given = {**vars(args), "allow_origins": " ".join(args.allow_origins)}
    names = {item.name for item in fields(ViewConfig)}
    return ViewConfig(**{k: v for k, v in given.items() if k in names and v is not None})


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code."""
    config = chosen(args)
    if args.run is None:
        from koop_view.node import run  # imports rclpy

        return run(ros_arguments(config))
    if config.operate:
        raise ValueError("--operate: a recording cannot be operated")
    from koop_view.recorded import RecordedSource
    from koop_view.serving import serve

    asyncio.run(serve(RecordedSource(args.run), config))
    return 0


def ros_arguments(config: ViewConfig) -> list[str]:
    """Return what hands a configuration to the node."""
    words = ["--ros-args"]
    for name, value in asdict(config).items():
        if value != "":
            text = str(value).lower() if isinstance(value, bool) else str(value)
            text = f"'{text}'" if isinstance(value, str) else text
            words += ["-p", f"{name}:={text}"]
    return words
