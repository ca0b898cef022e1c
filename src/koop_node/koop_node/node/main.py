"""Run one node as a process: start, spin, end cleanly."""

from __future__ import annotations

import inspect
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import rclpy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from koop_core.config.describe import ARGUMENTS, help_text
from koop_core.config.parameter import NodeConfig
from koop_core.errors import InputError
from koop_node.node import schedule
from koop_node.node.dds_profile import set_dds_profile
from koop_node.node.executor import Executor
from koop_node.node.managed import ManagedNode
from koop_node.node.stages import Stages, stages_of_one
from koop_node.process.housekeeping import Housekeeping
from koop_node.process.lifeline import end_with_parent
from koop_node.process.realtime import apply_priority

USAGE = f"a node takes {ARGUMENTS}; --help lists its parameters"
POLL = 0.1  # [s] how long a signal may go unnoticed: the executor waits outside Python


def run(node_class: type[ManagedNode[Any]]) -> int:
    """Run a node until it finishes or the process is told to stop; with ``--help`` print its.

    The node's constructor needs no argument. Returns the exit code of :func:`run_nodes`.
    """
    if {"-h", "--help"} & set(sys.argv[1:]):
        print(help_of(node_class, sys.argv[0]))
        return 0

    def make() -> list[ManagedNode[Any]]:
        if rest := remove_ros_args()[1:]:  # rclpy would ignore them
            raise InputError(f"unknown argument {' '.join(rest)}; {USAGE}")
        return [node_class()]  # type: ignore[call-arg]

    return run_nodes(make)


def run_nodes(
    make: Callable[[], list[ManagedNode[Any]]],
    find_stages: Callable[[list[ManagedNode[Any]]], list[Stages]] = stages_of_one,
) -> int:
    """Run nodes on one executor until one finishes or the process is told to stop.

    SIGINT and SIGTERM end the process cleanly. The handlers only set a flag, so that no callback
    is interrupted and the context stays valid for the last publications.

    ``make`` returns the nodes, those that listen before those that speak; rclpy is ready then.
    ``find_stages`` returns their compiled stages; ``KOOP_COMPILED=0`` does without them. Returns 0
    after a clean end, 1 if a node failed or ended before the last one, 2 if it cannot start.
    """
    with schedule.running() as timers:

        def on_signal(number: int, frame: FrameType | None) -> None:
            timers.asked = number

        signal.signal(signal.SIGINT, on_signal)
        signal.signal(signal.SIGTERM, on_signal)
        end_with_parent()
        set_dds_profile()
        try:
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
            nodes = make()
            priority = max((node.parameters[NodeConfig].priority for node in nodes), default=0)
        except Exception as error:  # whatever the start-up raises, the user gets one line
            print(f"error: {_one_line(error)}", file=sys.stderr)
            rclpy.try_shutdown()
            return 2
        without = os.environ.get("KOOP_COMPILED") == "0"
        return _spin(nodes, priority, timers, [] if without else find_stages(nodes))


def _spin(
    nodes: list[ManagedNode[Any]],
    priority: int,
    timers: schedule.Schedule,
    stages: list[Stages],
) -> int:
    """Run nodes until one finishes or the schedule is asked to end; return the exit code."""
    executor = Executor()
    for node in nodes:
        executor.add_node(node)
    house = Housekeeping(time.monotonic())
    asked = False
    ended: list[ManagedNode[Any]] = []
    code = 0
    try:
        while not (ended or (timers.asked and all([node.may_end(timers.asked) for node in nodes]))):
            timers.run_due()
            now, wait = time.monotonic(), timers.wait(POLL)
            house.tidy(now, min([wait, *(each.due - now for each in stages)]))
            if not asked and all(node.active for node in nodes):
                asked = True
                house.settle()  # numba and the kernels have come with the nodes' configuration
                for problem in apply_priority(priority):
                    nodes[0].get_logger().warning(problem)
            for each in stages:
                each(executor, now + wait)
            left = now + wait - time.monotonic()
            executor.run(0.0 if timers.ended else max(left, 0.0))
            if timers.ended:
                ended = [node for node in nodes if node.exit_code is not None]
        if ended:
            code = ended[0].exit_code or 0
            if ended[0] is not nodes[-1]:
                ended[0].get_logger().error("has ended: the other nodes end with it")
                code = code or 1
    except Exception:
        timers.asked = signal.SIGTERM  # no orderly end: a guard returns theta, whatever on_end says
        raise
    finally:
        try:
            for node in reversed(nodes):  # speakers end before those who listen to them
                node.close()
        finally:
            house.end()
            # Under a launch file Ctrl-C comes twice, and the interpreter, when it ends, puts back
            # the default handler, which would kill the process; an ignored signal stays ignored.
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
            for node in nodes:
                executor.remove_node(node)
                node.destroy_node()
            executor.shutdown()
            rclpy.try_shutdown()
    return code


def help_of(node_class: type[ManagedNode[Any]], path: str) -> str:
    """Return what ``--help`` of a node prints; ``path`` leads to its executable."""
    program = Path(path)
    if program.parent.parent.name == "lib":
        words = f"ros2 run {program.parent.name} {program.name}"
    else:
        words = program.name
    purpose = " ".join(inspect.cleandoc(node_class.__doc__ or "").split("\n\n")[0].split())
    return help_text(words, purpose, node_class.config_classes())


def _one_line(error: Exception) -> str:
    if type(error).__name__ == "UnknownROSArgsError":  # its text is a Python list
        return f"unknown argument after --ros-args: {str(error).strip('[]')}; {USAGE}"
    return (str(error).strip() or repr(error)).splitlines()[0]
