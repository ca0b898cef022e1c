"""``koop bench all``: every benchmark in turn, its output put between the marks of a document."""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
import time
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from koop_core.config.parameter import ConfigError
from koop_view.report.markdown import rewrite_block

# Of two cores half an hour at most: what each needs to say something, not its default.
PLAN: dict[str, tuple[str, ...]] = {
    "loop": ("loop",),
    "realtime": (
        "realtime --variants bare priority --rates 200 500 1000",
        "realtime --variants priority --rates 250 --search",
        "realtime --variants usual --rates 200 1000 --duration 30",
        "realtime --variants bare priority --rates 200 1000 --duration 30 --busy",
    ),
    "fleet": ("fleet --priority 30 --duration 20 --sizes 1 20 40 60 80",),
    "start": ("start",),
    "memory": ("memory",),
    "serve": ("serve --duration 20",),
    "offline": ("offline",),
    "record": ("record --duration 60 --overload 10 --kills 5",),
    "bags": ("bags --duration 20",),
    "identify": ("identify --share 0.2",),
    "training": ("training",),
}
MACHINE = "machine"
QUIET = 0.5  # load average from which the document says that the machine was not quiet


def register(benchmarks: Any) -> None:
    """Add the command to the subparsers of ``koop bench``."""
    parser = benchmarks.add_parser(
        "all",
        help="every benchmark, about 25 min; the tables of docs/benchmarks.md",
        description="Runs every benchmark, about 25 min on two cores, and writes what it printed "
        "between its marks in a Markdown file. Let nothing else run meanwhile.",
    )
    parser.add_argument(
        "--write", type=Path, default=Path("docs/benchmarks.md"), metavar="FILE",
        help="the Markdown file (default docs/benchmarks.md)",
    )  # fmt: skip
    parser.add_argument(
        "--only", nargs="+", choices=tuple(PLAN), metavar="NAME",
        help=f"just these, the others stay as they are: {', '.join(PLAN)}",
    )  # fmt: skip
    parser.add_argument(
        "--python", type=Path, default=Path(sys.executable), metavar="FILE",
        help="Python that has PyDMD and pykoop, for the benchmark 'identify'",
    )  # fmt: skip
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 1 if a benchmark failed."""
    names = args.only or list(PLAN)
    text = read(args.write)
    for name in (MACHINE, *PLAN):
        replaced(text, name, "", args.write)  # complain before the work, not after it
    if not args.only:
        write(args.write, MACHINE, machine())
    failed = []
    for name in names:
        parts = []
        for words in PLAN[name]:
            block, code = measured([*words.split(), *_own(name, args)], words)
            parts.append(block)
            if code:
                failed.append(f"'koop bench {words}' (exit code {code})")
        write(args.write, name, "\n\n".join(parts))
    for each in failed:
        print(f"failed: {each}", file=sys.stderr)
    print(f"{args.write}: {len(names)} benchmarks, {len(failed)} failed commands")
    return 1 if failed else 0


def _own(name: str, args: argparse.Namespace) -> list[str]:
    return ["--python", str(args.python)] if name == "identify" else []


def machine() -> str:
    """Return what the figures were taken on, as Markdown."""
    now = datetime.now(timezone.utc)
    load = os.getloadavg()[0]
    cpu = next(
        (
            line.split(":")[1].strip()
            for line in Path("/proc/cpuinfo").read_text().splitlines()
            if line.startswith("model name")
        ),
        platform.machine(),
    )
    busy = "" if load < QUIET else " **Not a quiet machine: its figures are bounds.**"
    return (
        f"Taken by `./koop bench all` on {now.day} {now:%B %Y}, {now:%H:%M} UTC, on {cpu}, "
        f"{len(os.sched_getaffinity(0))} processors, Linux {platform.release()}, Python "
        f"{platform.python_version()}, load average at the start {load:.2f}.{busy}"
    )


def measured(command: list[str], words: str) -> tuple[str, int]:
    """Run a benchmark in a process of its own; return its output as Markdown, and its exit code."""
    load, begin = os.getloadavg()[0], time.monotonic()
    print(f"\n$ koop bench {words}", flush=True)
    lines = []
    with subprocess.Popen(
        [sys.executable, "-m", "koop_lab", "bench", *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        assert process.stdout is not None
        try:
            for line in process.stdout:
                print(line, end="", flush=True)
                lines.append(line.rstrip())
        except BaseException:
            process.terminate()  # leaving the block waits for it
            raise
    took = time.monotonic() - begin
    head = f"`./koop bench {words}`, {took:.0f} s, load average before it {load:.2f}"
    if process.returncode:
        head += f", **failed with exit code {process.returncode}**"
    return "\n".join([f"{head}:", "", "```text", *lines, "```"]), process.returncode


def read(path: Path) -> str:
    """Return the text of the document.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If it is not there.
    """
    if not path.is_file():
        raise ConfigError(f"{path} is not there: run this in the repository's root, or say --write")
    return path.read_text(encoding="utf-8")


def replaced(text: str, name: str, block: str, path: Path) -> str:
    """Return the text with another block between the marks of a benchmark.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If it has not these marks.
    """
    marks = f"<!-- bench {name} -->", f"<!-- end of bench {name} -->"
    try:
        return rewrite_block(text, block, marks)
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None


def write(path: Path, name: str, block: str) -> None:
    """Put a block between its marks; who edits the rest meanwhile loses nothing."""
    path.write_text(replaced(read(path), name, block, path), encoding="utf-8")
