"""Run one node as a process: start, spin, end cleanly."""

from __future__ import annotations

import inspect
import os
import signal
import sys
from importlib.resources import files
from pathlib import Path
from types import FrameType
from typing import Any

import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from koop_node.describe import ARGUMENTS, help_text
from koop_node.lifeline import end_with_parent
from koop_node.managed import ManagedNode

USAGE = f"a node takes {ARGUMENTS}; --help lists its parameters"
POLL = 0.1  # [s] how long a signal may go unnoticed: the executor waits outside Python


def set_dds_profile() -> None:
    """Let Fast DDS notice a loss in 10 ms and never wait for a lost host.

    To be called before DDS starts in this process.
    """
    os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(files("koop_node") / "fastdds.xml"))


def run(node_class: type[ManagedNode[Any]], args: list[str] | None = None) -> int:
    """Run a node until it finishes or the process is told to stop; with ``--help`` print its.

    The node's constructor needs no argument.

    SIGINT and SIGTERM end the process cleanly. The handlers only set a flag, so that no callback
    is interrupted and the context stays valid for the last publications.

    Returns
    -------
    int
        Exit code: 0 after a clean end, 1 if the node failed, 2 if it could not start.
    """
    if {"-h", "--help"} & set(sys.argv[1:] if args is None else args):
        print(help_of(node_class, sys.argv[0]))
        return 0
    stop: list[int] = []

    def on_signal(number: int, frame: FrameType | None) -> None:
        stop.append(number)

    signal.signal(signal.SIGINT, on_signal)
    signal.signal(signal.SIGTERM, on_signal)
    end_with_parent()
    set_dds_profile()
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        refuse_other_arguments(args)
        node = node_class()  # type: ignore[call-arg]
    except Exception as error:  # whatever the start-up raises, the user gets one line
        print(f"error: {_one_line(error)}", file=sys.stderr)
        rclpy.try_shutdown()
        return 2
    executor: Any = EventsExecutor()
    executor.add_node(node)
    try:
        # EventsExecutor.spin() would hang in the Jazzy wheels and ignore the flag
        while node.exit_code is None and not stop:
            executor.spin_once(timeout_sec=POLL)
        node.close()
    finally:
        # Under a launch file Ctrl-C comes twice, and the interpreter, when it ends, puts back the
        # default handler, which would kill the process; an ignored signal stays ignored.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        executor.remove_node(node)
        node.destroy_node()
        executor.shutdown()
        rclpy.try_shutdown()
    return node.exit_code or 0


def help_of(node_class: type[ManagedNode[Any]], path: str) -> str:
    """Return what ``--help`` of a node prints; ``path`` is that of its executable."""
    program = Path(path)
    if program.parent.parent.name == "lib":
        words = f"ros2 run {program.parent.name} {program.name}"
    else:
        words = program.name
    purpose = " ".join(inspect.cleandoc(node_class.__doc__ or "").split("\n\n")[0].split())
    return help_text(words, purpose, node_class.config_classes())


def refuse_other_arguments(args: list[str] | None = None) -> None:
    """Raise ValueError if there are arguments besides those of ROS, which rclpy would ignore."""
    own = remove_ros_args(args)
    own = own[1:] if args is None else own
    if own:
        raise ValueError(f"unknown argument {' '.join(own)}; {USAGE}")


def _one_line(error: Exception) -> str:
    if type(error).__name__ == "UnknownROSArgsError":  # its text is a Python list
        return f"unknown argument after --ros-args: {str(error).strip('[]')}; {USAGE}"
    return (str(error).strip() or repr(error)).splitlines()[0]
