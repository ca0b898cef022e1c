"""The ``koop`` command line."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from importlib import import_module
from types import FrameType

from koop_bag.cli import bag_commands
from koop_bag.errors import BagError
from koop_lab.live.loop import LiveError
from koop_lab.recorded.report import register_bag_commands

# A command is a module with register(subparsers); it sets ``func``, which returns the exit code.
COMMANDS = (
    "koop_lab.live.demo",
    "koop_lab.cli.simulate",
    "koop_lab.identify.command",
    "koop_lab.replay.command",
    "koop_bag.cli",
    "koop_lab.bench.command",
    "koop_hil.command",
    "koop_study.command",
)


def parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    result = argparse.ArgumentParser(
        prog="koop", description="Oscillation damping by extremum seeking in a Koopman-lifted space"
    )
    commands = result.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for module in COMMANDS:
        import_module(module).register(commands)
    register_bag_commands(bag_commands(commands))
    return result


def main(argv: list[str] | None = None) -> int:
    """Run a command; bad input ends in one line on stderr and exit code 2."""
    args = parser().parse_args(argv)
    if signal.getsignal(signal.SIGINT) == signal.SIG_DFL:  # see koop_lab.__main__
        signal.signal(signal.SIGINT, signal.default_int_handler)
    # a closed terminal or a supervisor's stop must end the nodes that were started, as Ctrl-C does
    signal.signal(signal.SIGTERM, _interrupt)
    signal.signal(signal.SIGHUP, _interrupt)
    try:
        code = int(args.func(args))
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # `| head` has seen enough
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115 - until the process ends
        return 0
    except (ValueError, OSError, ArithmeticError, MemoryError, BagError, LiveError) as error:
        words = [args.command, *(getattr(args, name, "") for name in ("action", "benchmark"))]
        print(f"koop {' '.join(filter(None, words))}: error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt
