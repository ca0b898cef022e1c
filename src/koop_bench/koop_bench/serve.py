"""``koop bench serve``: what a page costs the loop that it shows."""

from __future__ import annotations

import argparse
import asyncio
import json
import re
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from koop_bag.bag.columns import read_tables
from koop_bag.bag.reader import BagReader
from koop_bringup.live.process import NodeProcess
from koop_bringup.live.served import said
from koop_core.errors import LiveError
from koop_lab.commands.demo import run_with_progress
from koop_loop.parameters import make
from koop_view.protocol import SUBPROTOCOLS

TOPICS = ("/state", "/cost", "/theta", "/ground_truth", "/diagnostics", "/rosout")


def register(benchmarks: Any) -> None:
    """Add the benchmark to the subparsers of ``koop bench``."""
    parser = benchmarks.add_parser(
        "serve", help="rate and latency of the loop with no page, one and more open"
    )
    parser.add_argument("--duration", type=float, default=30.0, metavar="S", help="of each run")
    parser.add_argument(
        "--pages", type=int, nargs="+", default=[0, 1, 5], metavar="N", help="numbers of pages"
    )
    parser.add_argument(
        "--pace", choices=("realtime", "lockstep"), default="realtime",
        help="realtime: 200 Hz; lockstep: as fast as the machine allows",
    )  # fmt: skip
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code."""
    print("a process each; latency: from writing the state to writing its theta, as recorded")
    print(f"{'pages':<16}{'steps/s':>9}{'median':>9}{'99 %':>9}{'99.9 %':>9} [ms]   lost  server")
    without = measure(args, None)
    for pages in args.pages:
        measure(args, pages, without)
    return 0


def measure(args: argparse.Namespace, pages: int | None, baseline: float = float("nan")) -> float:
    """Run a loop with a number of pages, None for no server; print a line, return its rate."""
    parameters = make({"vdp_plant": {"duration": args.duration, "pace": args.pace}})
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        watched = stack.enter_context(watching(folder, pages)) if pages is not None else None
        run_with_progress(folder / "run", parameters)
        share = "" if watched is None else f"{watched.share():8.1%}"
        got = "" if watched is None or not pages else f"  {watched.got} messages shown"
        with BagReader(folder / "run") as bag:
            tables = read_tables(
                bag,
                {t: ["step", "publish_time"] for t in ("/state", "/theta")},
            )
    state, theta = tables["/state"], tables["/theta"]
    lost = sum(int(np.sum(np.diff(t["step"].astype(np.int64)) - 1)) for t in (state, theta))
    _, at, answer = np.intersect1d(state["step"], theta["step"], return_indices=True)
    sent = state["publish_time"].astype(np.int64)
    latency = (theta["publish_time"].astype(np.int64)[answer] - sent[at]) * 1e-6
    rate = (len(sent) - 1) / float(sent[-1] - sent[0]) * 1e9
    median, high, highest = np.quantile(latency, [0.5, 0.99, 0.999])
    label = "no server" if pages is None else f"server, {pages} open"
    ratio = f"  {rate / baseline:.2f} of the rate without" if np.isfinite(baseline) else ""
    print(
        f"{label:<16}{rate:9.1f}{median:9.2f}{high:9.2f}{highest:9.2f}      {lost:>4}"
        f"{share}{got}{ratio}",
        flush=True,
    )
    return rate


class Watched:
    """What the pages got, and what the server used."""

    def __init__(self, process: NodeProcess) -> None:
        self.got = 0
        self._process = process
        self._begin = (time.monotonic(), self._used())

    def share(self) -> float:
        """Return the share of a processor that the server has used."""
        begin, used = self._begin
        return (self._used() - used) / (time.monotonic() - begin)

    def _used(self) -> float:
        stat = Path(f"/proc/{self._process.process.pid}/stat").read_text()
        words = stat.rpartition(")")[2].split()
        return (int(words[11]) + int(words[12])) / 100.0


@contextmanager
def watching(folder: Path, pages: int) -> Iterator[Watched]:
    """Serve the ROS domain and look at it with some clients while the context lasts."""
    words = ["serve", "--port", "0"]
    process = NodeProcess("view", words, folder / "view.log", [sys.executable, "-m", "koop_lab"])
    try:
        found = re.search(r":(\d+)/", said(process))
        if found is None:
            raise LiveError(f"the server did not start: {process.last_lines()}")
        watched = Watched(process)
        over = threading.Event()
        work = _look_on(int(found[1]), pages, watched, over)
        thread = threading.Thread(target=lambda: asyncio.run(work))
        thread.start()
        try:
            yield watched
        finally:
            over.set()
            thread.join()
    finally:
        process.stop()


async def _look_on(port: int, pages: int, watched: Watched, over: threading.Event) -> None:
    """Look with several clients until it is over."""
    tasks = [asyncio.create_task(_look(port, watched)) for _ in range(pages)]
    while not over.is_set():
        await asyncio.sleep(0.1)
    for task in tasks:
        task.cancel()
    for failed in await asyncio.gather(*tasks, return_exceptions=True):
        if not isinstance(failed, asyncio.CancelledError):
            print(f"note: a page was closed: {failed}", flush=True)


async def _look(port: int, watched: Watched) -> None:
    """Look at what the page looks at."""
    from websockets.asyncio.client import connect
    from websockets.typing import Subprotocol

    offered = [Subprotocol(name) for name in SUBPROTOCOLS]
    address = f"ws://127.0.0.1:{port}/"
    options: Any = {"subprotocols": offered, "max_size": None, "compression": None}
    async with connect(address, **options) as connection:
        async for message in connection:
            if isinstance(message, bytes):
                watched.got += 1
            elif (said := json.loads(message))["op"] == "advertise":
                pairs = [
                    {"id": item["id"], "channelId": item["id"]}
                    for item in said["channels"]
                    if item["topic"] in TOPICS
                ]
                await connection.send(json.dumps({"op": "subscribe", "subscriptions": pairs}))
