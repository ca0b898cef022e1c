"""The ``koop`` command line: finds the commands that the installed packages bring, and runs one.

A package brings a command by an entry point of the group ``koop.commands``: its name is the
command's, and it names a function that adds it to the subparsers and sets ``func``, which returns
the exit code. A second package may add to a command of the same name.
"""

from __future__ import annotations

import argparse
import difflib
import gc
import io
import os
import re
import signal
import sys
import traceback
from collections.abc import Iterable
from importlib.metadata import EntryPoint, entry_points
from importlib.resources import files

from koop_core.errors import KoopError

FAULT = 70  # exit code of a fault of this software, as in sysexits.h
REPORT = (
    "koop: this is a fault of koop, not of your input: please report it with the lines above and "
    "the command (CONTRIBUTING.md says where)"
)


def registered() -> dict[str, list[EntryPoint]]:
    """Return the entry points of every command."""
    commands: dict[str, list[EntryPoint]] = {}
    for entry in entry_points(group="koop.commands"):
        commands.setdefault(entry.name, []).append(entry)
    return commands


def overview() -> str:
    """Return what every command of this workspace does, in groups, as ``./koop --help`` has it."""
    return (files("koop_lab.cli") / "commands.txt").read_text(encoding="utf-8")


def parser(*names: str) -> argparse.ArgumentParser:
    """Return the parser of some commands, by default of all.

    What a command imports takes up to a second, so only the command that runs is loaded.
    """
    result = argparse.ArgumentParser(prog="koop")
    commands = result.add_subparsers(dest="command", metavar="COMMAND", required=True)
    entries = registered()
    for register in dict.fromkeys(e.load() for name in names or entries for e in entries[name]):
        register(commands)
    summaries = dict(re.findall(r"^  (\w+) +(.+)$", overview(), re.MULTILINE))
    for name, command in commands.choices.items():
        command.description = command.description or summaries.get(name)
    return result


def hint_for(name: str, allowed: Iterable[str], command: str) -> str:
    """Say which name must have been meant, or which command's help lists them."""
    near = difflib.get_close_matches(name, allowed, 1)
    return f"did you mean '{near[0]}'?" if near else f"see {command} --help"


def option_names(parser: argparse.ArgumentParser) -> list[str]:
    """Return the options of a parser and of its commands."""
    names: list[str] = []
    for action in parser._actions:
        names += action.option_strings
        if isinstance(action, argparse._SubParsersAction):
            names += [name for sub in action.choices.values() for name in option_names(sub)]
    return names


def main(argv: list[str] | None = None) -> int:
    """Run a command and return its exit code.

    What a user can mend ends in one line on stderr and exit code 2; any other exception is a fault
    of this software and ends in its traceback and exit code 70.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):  # in a pipe, too, each line comes at once
        sys.stdout.reconfigure(line_buffering=True)
    words = sys.argv[1:] if argv is None else argv
    if not words or words[0] in ("-h", "--help"):
        print(
            "usage: koop COMMAND [ARGUMENTS]    (COMMAND --help lists them)\n\n" + overview(),
            end="",
        )
        return 0
    if words[0] not in (commands := registered()):
        hint = hint_for(words[0], commands, "koop")
        kind = "option" if words[0].startswith("-") else "command"
        print(f"koop: error: no {kind} '{words[0]}': {hint}", file=sys.stderr)
        return 2
    commands_parser = parser(words[0])
    if not gc.isenabled():  # see koop_lab.__main__
        gc.freeze()
        gc.enable()
    args, unknown = commands_parser.parse_known_args(words)
    command = " ".join(filter(None, ("koop", args.command, getattr(args, "action", ""))))
    if unknown:
        hint = hint_for(unknown[0].partition("=")[0], option_names(commands_parser), command)
        print(f"{command}: error: unknown argument '{unknown[0]}': {hint}", file=sys.stderr)
        return 2
    if signal.getsignal(signal.SIGINT) == signal.SIG_DFL:  # see koop_lab.__main__
        signal.signal(signal.SIGINT, signal.default_int_handler)
    # a closed terminal or a supervisor's stop must end the nodes that were started, as Ctrl-C does
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.default_int_handler)
    try:
        code = int(args.func(args))
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # `| head` has ended
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115 - until the process ends
        return 0
    except (KoopError, OSError, MemoryError) as error:  # the user's input, or the machine's limits
        text = str(error) or "out of memory"
        if isinstance(error, OSError) and error.filename:
            from koop_core.whole_file import describe_failure

            text = describe_failure(error.filename, error)
        print(f"{command}: error: {text}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except Exception:
        traceback.print_exc()
        print(REPORT, file=sys.stderr)
        return FAULT
