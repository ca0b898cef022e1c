"""The closed loop: plant, lifter, controller and, on request, the recorder.

    ros2 launch koop_bringup closed_loop.launch.py pace:=lockstep duration:=100.0 record:=true

With ``plant:=false`` your own rig takes the plant's place: it publishes ``state`` and listens to
``theta`` in the same namespace. What the arguments and the parameter file amount to is decided in
``koop_bringup.plan``, before a node starts; what ends it: docs/reference/exit-codes.md.

Another launch file may include it, also several times: the end of one loop ends that one's
processes only, and what ``SetParameter`` gives to a group reaches the nodes that have it.
"""

import asyncio
import os
import signal
import sys
import time
from contextlib import ExitStack, suppress
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    ExecuteProcess,
    GroupAction,
    LogInfo,
    OpaqueCoroutine,
    OpaqueFunction,
    RegisterEventHandler,
    UnsetLaunchConfiguration,
)
from launch.event_handlers import OnShutdown
from launch.events.matchers import matches_action
from launch.events.process import ProcessExited, ShutdownProcess, SignalProcess
from launch.logging import get_logger, launch_config
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from koop_bringup.plan import ARGUMENTS, plan, refuse_other_arguments, return_time
from koop_core.config.parameter_file import write
from koop_core.ended import PATH
from koop_core.journal import make_journal
from koop_guard.config import SAFETY
from koop_guard.node.memory_file import open_memory_file
from koop_guard.note import TWIN
from koop_loop.ending import Ending, describe_end, ending
from koop_node.client.alone import TOPICS, alone, is_claimed
from koop_node.process.lifeline import DEFERRED, TIED, take_signals

STOP_TIMEOUT = 10.0  # [s] for a recorder to close its bag
SET = "global_params"  # where launch_ros keeps what SetParameter and its like give to all nodes


def generate_launch_description() -> LaunchDescription:
    """Describe the launch."""
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(
                    item.name,
                    default_value="",
                    description=item.meaning,
                    choices=["", *item.choices] if item.choices else None,
                )
                for item in ARGUMENTS
            ),
            OpaqueFunction(function=_start),
        ]
    )


def _start(context: LaunchContext) -> list:
    """Check everything, then return the processes."""
    refuse_other_arguments(context.argv)
    texts = {item.name: context.launch_configurations[item.name] for item in ARGUMENTS}
    if not texts["namespace"].startswith("/"):
        around = context.launch_configurations.get("ros_namespace", "")
        texts["namespace"] = f"{around}/{texts['namespace']}"
    of_group = context.launch_configurations.get(SET, [])
    planned = plan(texts, dict(item for item in of_group if isinstance(item, tuple)))
    name = f"given_parameters{planned.namespace.replace('/', '-')}.yaml"
    file = Path(launch_config.log_dir) / name
    write(planned.parameters, file)
    by_others = planned.rig and not planned.program
    published = [topic for topic in TOPICS if topic != "state" or not by_others]
    returning = return_time(planned.parameters)
    loop = _Loop(planned.rig, alone(planned.namespace, published), returning)
    shared = {  # launch holds a pipe to their stdin: TIED
        "output": "screen",
        "sigterm_timeout": str(STOP_TIMEOUT + returning),
        "prefix": LaunchConfiguration("launch-prefix", default=""),
    }
    environment = {**TIED, **planned.environment, **loop.told_by}
    if planned.journaled:
        environment |= loop.make_journal()
    files = [item for item in of_group if not isinstance(item, tuple)]
    for node in planned.processes():
        loop.processes.append(
            Node(
                package=node.package,
                executable=node.executable,
                exec_name=node.executable,
                arguments=node.arguments,
                ros_arguments=[word for rule in planned.remaps for word in ("-r", rule)],
                namespace=planned.namespace or "/",
                parameters=[*files, file],
                on_exit=loop.on_exit(node.name, node.executable if node.arguments else ""),
                additional_env=environment,
                **shared,
            )
        )
        if node.name == "koop_guard":
            loop.guard = loop.processes[-1]
    if planned.program:
        words = [sys.executable, "-m", "koop_node.process.companion", *planned.program]
        on_exit = loop.on_exit("rig")
        program = ExecuteProcess(
            name="rig", cmd=words, on_exit=on_exit, additional_env=TIED, **shared
        )
        loop.processes.append(program)
    return [
        *(LogInfo(msg=note) for note in planned.notes),
        RegisterEventHandler(OnShutdown(on_shutdown=loop.on_shutdown)),
        OpaqueCoroutine(coroutine=_defer_signals, args=[loop.processes], ignore_context=True),
        GroupAction([UnsetLaunchConfiguration(SET), *loop.processes]),
    ]


async def _defer_signals(nodes: list) -> None:
    """Let Ctrl-C wait until the processes have started.

    A process inherits that, until it handles signals (koop_node.node.start). Launch would wait
    without end for one that Ctrl-C ended at once, or whose start KeyboardInterrupt cut short.
    """
    signal.pthread_sigmask(signal.SIG_BLOCK, DEFERRED)
    interrupt = signal.signal(signal.SIGINT, lambda number, frame: None)
    try:
        while not all("pid" in p.process_details or p.get_asyncio_future().done() for p in nodes):
            await asyncio.sleep(0.01)
    except asyncio.CancelledError:
        pass  # launch would take it for its own
    finally:
        take_signals()
        signal.signal(signal.SIGINT, interrupt)


class _Loop:
    """The processes of one loop, in a launch that may hold others.

    Parameters
    ----------
    rig : bool
        Whether a rig is the plant.
    place : context manager
        The loop's place in its ROS domain, held until the last process has ended.
    returning : float
        How long theta may take to return [s].
    """

    def __init__(self, rig: bool, place, returning: float):
        self.processes = []
        self.guard = None
        self._rig = rig
        self._returning = returning + SAFETY.matched + SAFETY.held
        self._ended = 0
        self._ending = False
        self._failure = ""  # why the launch is to end with exit code 1
        self._place = ExitStack()
        self._place.enter_context(place)
        self._told, self.told_by = -1, {}  # where the nodes find why the loop ends
        with suppress(OSError):
            self._told = self._place.enter_context(open_memory_file("koop_ended")).fileno()
            self.told_by = {PATH: f"/proc/{os.getpid()}/fd/{self._told}"}

    def make_journal(self) -> dict[str, str]:
        """Make a journal for as long as the loop lasts; return what its processes know it by."""
        descriptor, environment = make_journal()
        self._place.callback(os.close, descriptor)
        return environment

    def on_exit(self, node: str, container: str = ""):
        """Return what to do when a node ends, or the container whose end counts as the node's."""

        def ended(event: ProcessExited, context: LaunchContext) -> list:
            self._ended += 1
            if self._ended == len(self.processes):
                self._place.close()
            text = describe_end(container or node, event.returncode)
            kind_of_end = ending(node, event.returncode, self._rig)
            actions = []
            if context.is_shutdown or self._ending:
                if event.returncode:
                    self._failure = self._failure or text
            elif kind_of_end is Ending.GO_ON:
                get_logger("launch").error(f"{text}: the loop goes on without it")
                self._failure = text
            else:
                get_logger("launch").info(f"{text}: the loop ends")
                if kind_of_end is Ending.FAILED:
                    self._failure = text
                    if self._told >= 0 and self._ended < len(self.processes):
                        os.pwrite(self._told, text.encode(), 0)
                actions = self._end(event, kind_of_end is Ending.DONE)
            if context.is_shutdown:
                self._raise()
            return actions

        return ended

    def on_shutdown(self, event, context: LaunchContext) -> list:
        """Give the launch its exit code, if nothing of the loop is left that could do so.

        Launch does not forward Ctrl-C, which a process that starts meanwhile has not received.
        """
        if self._ended == len(self.processes):
            self._raise()
        ends = (ShutdownProcess(process_matcher=matches_action(p)) for p in self.processes)
        return [EmitEvent(event=end) for end in ends]

    def _end(self, event: ProcessExited, orderly: bool) -> list:
        """Return what ends the other processes; the guard knows a failure by SIGTERM."""
        self._ending = True

        def end(process):
            if process is self.guard and not orderly:
                return SignalProcess(
                    signal_number=signal.SIGTERM, process_matcher=matches_action(process)
                )
            return ShutdownProcess(process_matcher=matches_action(process))

        others = [process for process in self.processes if process is not event.action]
        if event.action is not self.guard or event.returncode >= 0:
            return [EmitEvent(event=end(process)) for process in others]

        async def end_after_twin(context: LaunchContext) -> None:  # which returns theta
            deadline = time.monotonic() + self._returning
            with suppress(asyncio.CancelledError):
                while is_claimed(f"{TWIN}{event.pid}") and time.monotonic() < deadline:
                    await asyncio.sleep(0.05)
                for process in others:
                    await context.emit_event(end(process))

        return [OpaqueCoroutine(coroutine=end_after_twin)]

    def _raise(self) -> None:
        """Raise what went wrong: an error is how a launch gets exit code 1."""
        failure, self._failure = self._failure, ""
        if failure:
            raise RuntimeError(failure)
