"""``koop status``: the loops that run on this machine, asked from any terminal."""

from __future__ import annotations

import argparse
from contextlib import suppress
from pathlib import Path
from typing import Any

from koop_core.errors import KoopError, LiveError
from koop_node.client.alone import PREFIX
from koop_node.client.desk import STATUS, STOP, ask, find_loops
from koop_tune.folder import find_controller

NONE = 3  # exit code where no loop runs, as of services (LSB)


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser(
        "status",
        description="Says of each loop of this machine how it is: theta, guard, rig, run folder. "
        "Exit code 0: healthy; 1: not healthy, or no answer; 3: no loop runs.",
    )
    parser.add_argument(
        "folder", metavar="FOLDER", nargs="?", type=Path,
        help="only the loop of this folder: as given to 'koop up', or of the run",
    )  # fmt: skip
    parser.add_argument(
        "--stop", action="store_true",
        help="end the loop as Ctrl-C does, wait, and say where theta is",
    )  # fmt: skip
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code."""
    answers: dict[str, dict[str, Any]] = {}
    for name in find_loops():
        try:
            answers[name] = ask(name, STATUS)
        except LiveError as error:
            answers[name] = {"healthy": False, "text": f"  {error}", "places": []}
    if args.folder is not None:
        places = _places(args.folder)
        answers = {n: a for n, a in answers.items() if places & set(a["places"])}
    if not answers:
        print("no loop runs" + f" of {args.folder}" * (args.folder is not None))
        return NONE
    if args.stop:
        return _stop(answers)
    for name, answer in answers.items():
        process = f", process {answer['pid']} of user {answer['user']}" if "pid" in answer else ""
        print(f"{_describe(name)}{process}\n{answer['text']}")
    return 0 if all(answer["healthy"] for answer in answers.values()) else 1


def _stop(answers: dict[str, dict[str, Any]]) -> int:
    if len(answers) > 1:
        names = ", ".join(map(_describe, answers))
        raise LiveError(f"{len(answers)} loops run ({names}): name the run folder of one")
    (name,) = answers
    print(f"ending the {_describe(name)}", flush=True)
    answer = ask(name, STOP, None)
    if "refused" in answer:
        raise LiveError(f"{_describe(name)}: {answer['refused']}")
    print(f"ended: {answer['text']}")
    return 0


def _places(folder: Path) -> set[str]:
    """Return the paths by which a loop may know itself."""
    places = {str(folder.resolve())}
    with suppress(KoopError):  # the folder of a run has no controller
        places.add(str(find_controller(folder)[0].resolve()))
    return places


def _describe(name: str) -> str:
    domain, _, namespace = name.removeprefix(PREFIX).partition("/")
    return f"loop on ROS domain {domain}" + f", namespace /{namespace}" * bool(namespace)
