"""The closed loop: plant, lifter, controller and, on request, the recorder.

    ros2 launch koop_bringup closed_loop.launch.py pace:=lockstep duration:=100.0 record:=true

With ``plant:=false`` your own rig takes the plant's place: it publishes ``state`` and listens to
``theta`` in the same namespace. What the arguments and the parameter file amount to is decided in
``koop_bringup.plan``, before a node starts; what ends it: docs/reference/exit-codes.md.

Another launch file may include it, also several times: the end of one loop ends that one's
processes only, and what ``SetParameter`` gives to a group reaches the nodes that have it.
"""

import signal
import sys
from contextlib import ExitStack
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    ExecuteProcess,
    GroupAction,
    LogInfo,
    OpaqueFunction,
    RegisterEventHandler,
    TimerAction,
    UnsetLaunchConfiguration,
)
from launch.event_handlers import OnShutdown
from launch.events.process import ProcessExited, ShutdownProcess, SignalProcess
from launch.logging import get_logger, launch_config
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from koop_bringup.plan import ARGUMENTS, plan, refuse_other_arguments, return_time
from koop_core.config.parameter_file import write
from koop_guard.config import SAFETY
from koop_loop.ending import Ending, describe_end, ending
from koop_node.client.alone import TOPICS, alone
from koop_node.process.lifeline import TIED

STOP_TIMEOUT = 10.0  # [s] for a recorder to close its bag
DEFERRED = "env --block-signal=INT,TERM "  # until the node handles them: see koop_node.node.start
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
    prefix = [
        DEFERRED if sys.platform == "linux" else "",
        LaunchConfiguration("launch-prefix", default=""),
    ]
    shared = {
        "additional_env": TIED,  # launch holds a pipe to their stdin
        "output": "screen",
        "sigterm_timeout": str(STOP_TIMEOUT + returning),
        "prefix": prefix,
    }
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
                on_exit=loop.on_exit(node.name),
                **shared,
            )
        )
        if node.name == "koop_guard":
            loop.guard = loop.processes[-1]
    if planned.program:
        words = [sys.executable, "-m", "koop_node.process.companion", *planned.program]
        program = ExecuteProcess(name="rig", cmd=words, on_exit=loop.on_exit("rig"), **shared)
        loop.processes.append(program)
    return [
        *(LogInfo(msg=note) for note in planned.notes),
        RegisterEventHandler(OnShutdown(on_shutdown=loop.on_shutdown)),
        GroupAction([UnsetLaunchConfiguration(SET), *loop.processes]),
    ]


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

    def on_exit(self, node: str):
        """Return what to do when a node ends."""

        def ended(event: ProcessExited, context: LaunchContext) -> list:
            self._ended += 1
            if self._ended == len(self.processes):
                self._place.close()
            text = describe_end(node, event.returncode)
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
                actions = self._end(event, kind_of_end is Ending.DONE)
            if context.is_shutdown:
                self._raise()
            return actions

        return ended

    def on_shutdown(self, event, context: LaunchContext) -> None:
        """Give the launch its exit code, if nothing of the loop is left that could do so."""
        if self._ended == len(self.processes):
            self._raise()

    def _end(self, event: ProcessExited, orderly: bool) -> list:
        """Return what ends the other processes; the guard knows a failure by SIGTERM."""
        self._ending = True

        def end(process):
            matcher = {"process_matcher": lambda action: action is process}
            if process is self.guard and not orderly:
                return SignalProcess(signal_number=signal.SIGTERM, **matcher)
            return ShutdownProcess(**matcher)

        others = [process for process in self.processes if process is not event.action]
        ends = [EmitEvent(event=end(process)) for process in others]
        if event.action is self.guard and event.returncode < 0:  # its twin returns theta
            return [TimerAction(period=self._returning, actions=ends)]
        return ends

    def _raise(self) -> None:
        """Raise what went wrong: an error is how a launch gets exit code 1."""
        failure, self._failure = self._failure, ""
        if failure:
            raise RuntimeError(failure)
