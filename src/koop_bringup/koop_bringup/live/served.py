"""``--serve``: the page of a loop that a command runs, in a process of its own."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from koop_bringup.live.process import START_TIMEOUT, NodeProcess
from koop_view.config import ADDRESS, ViewConfig


def add_serve_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--serve`` to a command that runs a loop."""
    parser.add_argument(
        "--serve",
        metavar="PORT",
        nargs="?",
        type=int,
        const=ViewConfig().port,
        help="show the loop on a page meanwhile, as koop serve --operate does; anyone with the "
        f"printed address may operate it (PORT: {ViewConfig().port} by default, 0: any)",
    )


@contextmanager
def served(port: int | None, folder: Path) -> Iterator[Callable[[str], None]]:
    """Serve the loops of the ROS domain while the context lasts; with None, do nothing.

    It gives a function that shows a line beside the loop. A page that fails ends no run.
    """
    if port is None:
        yield lambda line: None
        return
    about = folder / "view.txt"
    config = ViewConfig(operate=True, port=port, about=str(about))  # refuses one that cannot be
    folder.mkdir(parents=True, exist_ok=True)
    about.write_text("")
    code = (
        "from koop_view.config import ViewConfig\n"
        "from koop_view.node import run\n"
        f"raise SystemExit(run({config!r}))"
    )
    command = [sys.executable, "-c", code]
    log = folder / "view.log"
    log.touch(mode=0o600)  # it holds the token
    begin = log.stat().st_size  # what a command that goes on had printed before is over
    process = NodeProcess("view", [], log, command)

    def show(line: str) -> None:
        with suppress(OSError):  # a full disk hides it and ends no run
            about.write_text(line)

    try:
        print(said(process, begin), flush=True)
        yield show
    finally:
        process.stop()


def said(process: NodeProcess, begin: int = 0) -> str:
    """Return where the page is by the log from a byte on, or why there is none."""
    deadline = time.monotonic() + START_TIMEOUT
    while time.monotonic() < deadline:
        lines = process.log.read_bytes()[begin:].decode(errors="replace").splitlines()
        address = next((line for line in lines if line.startswith(ADDRESS)), None)
        if address is not None:
            return address
        if process.poll() is not None:
            break
        time.sleep(0.05)
    return f"note: the page is not served: {process.last_lines(1)}"
