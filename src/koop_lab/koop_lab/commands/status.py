"""``koop status``: the loops that run on this machine, asked from any terminal."""

from __future__ import annotations

import argparse
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path
from typing import Any

from koop_core.errors import KoopError, LiveError
from koop_node.client.alone import PREFIX
from koop_node.client.client import Client
from koop_node.client.desk import STATUS, STOP, ask, find_loops
from koop_tune.folder import find_controller

REARMED = 20.0  # [s] for the guard to say that it has rearmed
TOLD = 5.0  # [s] for the loop to have heard of it
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
    either = parser.add_mutually_exclusive_group()
    either.add_argument(
        "--stop", action="store_true",
        help="end the loop as Ctrl-C does, wait, and say where theta is",
    )  # fmt: skip
    either.add_argument(
        "--rearm", action="store_true",
        help="after a trip, let the controller command again; refused while the cause lasts",
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
        return _stop(_one_of(answers))
    if args.rearm:
        name = _one_of(answers)
        if not answers[name].get("guarded", True):  # of ros2 launch it is not known
            raise LiveError(f"{_describe(name)}: has no guard that could be rearmed")
        return _rearm(name)
    for name, answer in answers.items():
        process = f", process {answer['pid']} of user {answer['user']}" if "pid" in answer else ""
        print(f"{_describe(name)}{process}\n{answer['text']}")
    return 0 if all(answer["healthy"] for answer in answers.values()) else 1


def _one_of(names: Collection[str]) -> str:
    """Return the name of the loop that is meant."""
    if len(names) > 1:
        described = ", ".join(map(_describe, names))
        raise LiveError(f"{len(names)} loops run ({described}): name the run folder of one")
    return next(iter(names))


def _stop(name: str) -> int:
    print(f"ending the {_describe(name)}", flush=True)
    answer = ask(name, STOP, None)
    if "refused" in answer:
        raise LiveError(f"{_describe(name)}: {answer['refused']}")
    print(f"ended: {answer['text']}")
    return 0


def _rearm(name: str) -> int:
    """Call the guard's service, and wait until guard and loop say that it is no longer tripped.

    It rearms once the controller has answered that it begins again, which one that starts does not.
    """
    from koop_msgs.msg import GuardState
    from std_srvs.srv import Trigger

    from koop_node.node.qos import KEPT

    domain, namespace = _place(name)
    guard, states = f"{namespace}/koop_guard", list[GuardState]()
    with Client("_koop_status", domain) as client:
        client.node.create_subscription(GuardState, f"{guard}/state", states.append, KEPT)
        answer = client.call(Trigger, f"{guard}/rearm", Trigger.Request())
        if not answer.success:
            raise LiveError(f"{_describe(name)}: {answer.message}")

        def follows() -> bool:
            return bool(states) and states[-1].status == GuardState.FOLLOWING

        if not client.spin_until(follows, REARMED):
            now = "is not heard"
            if states:
                why = [states[-1].reason, *filter(None, [states[-1].rearm_refused])]
                now = f"is still tripped: {'; '.join(why)}"
            raise LiveError(
                f"{_describe(name)}: asked to rearm, but after {REARMED:g} s the guard {now}; it "
                "rearms when the controller has answered that it begins again: ask koop status"
            )
        client.spin_until(lambda: not _tells_of_trip(name), TOLD)
    print(f"{_describe(name)}: rearmed, {answer.message}")
    return 0


def _tells_of_trip(name: str) -> bool:
    """Return whether the loop still tells of a trip, which it hears of once a second."""
    with suppress(LiveError):  # one of ros2 launch tells nothing
        return ask(name, STATUS).get("guard") == "tripped"
    return False


def _places(folder: Path) -> set[str]:
    """Return the paths by which a loop may know itself."""
    places = {str(folder.resolve())}
    with suppress(KoopError):  # the folder of a run has no controller
        places.add(str(find_controller(folder)[0].resolve()))
    return places


def _place(name: str) -> tuple[int, str]:
    """Return ROS domain and namespace of a loop; the namespace is empty, or begins with /."""
    domain, _, namespace = name.removeprefix(PREFIX).partition("/")
    return int(domain), f"/{namespace}" * bool(namespace)


def _describe(name: str) -> str:
    domain, namespace = _place(name)
    return f"loop on ROS domain {domain}" + f", namespace {namespace}" * bool(namespace)
