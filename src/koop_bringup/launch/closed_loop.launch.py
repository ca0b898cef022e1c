"""The closed loop: plant, lifter, controller and, on request, the recorder.

    ros2 launch koop_bringup closed_loop.launch.py pace:=lockstep duration:=100.0 record:=true

With ``plant:=false`` your own rig takes the plant's place: it publishes ``state`` and listens to
``theta`` in the same namespace. What the arguments and the parameter file amount to is decided in
``koop_bringup.plan``, before a node starts; what ends it: docs/reference/exit-codes.md.
"""

import sys
from contextlib import ExitStack
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    ExecuteProcess,
    LogInfo,
    OpaqueFunction,
)
from launch.events import Shutdown
from launch.events.process import ProcessExited
from launch.logging import get_logger, launch_config
from launch_ros.actions import Node

from koop_bringup.plan import ARGUMENTS, plan, refuse_other_arguments
from koop_core.config.parameter_file import write
from koop_loop.ending import Ending, ending, told
from koop_node.client.alone import TOPICS, alone
from koop_node.process.lifeline import TIED

PLACE = ExitStack()  # of the loop in its ROS domain, held until the launch ends
STOP_TIMEOUT = "10"  # [s] for a recorder to close its bag


def generate_launch_description() -> LaunchDescription:
    """Describe the launch."""
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(item.name, default_value="", description=item.meaning)
                for item in ARGUMENTS
            ),
            OpaqueFunction(function=_start),
        ]
    )


def _start(context: LaunchContext) -> list:
    """Check everything, then return the nodes."""
    if any(Path(word).name == Path(__file__).name for word in sys.argv):  # not included by another
        refuse_other_arguments(context.argv)
    given = {item.name: context.launch_configurations[item.name] for item in ARGUMENTS}
    if not given["namespace"].startswith("/"):
        around = context.launch_configurations.get("ros_namespace", "")
        given["namespace"] = f"{around}/{given['namespace']}"
    planned = plan(given)
    name = f"given_parameters{planned.namespace.replace('/', '-')}.yaml"
    file = Path(launch_config.log_dir) / name
    write(planned.parameters, file)
    own = not planned.rig or planned.program
    published = [name for name in TOPICS if name != "state" or own]
    PLACE.enter_context(alone(planned.namespace, published))
    lost: list[str] = []
    return [
        *(LogInfo(msg=note) for note in planned.notes),
        *(
            Node(
                package=node.package,
                executable=node.executable,
                arguments=node.arguments,
                namespace=planned.namespace or "/",
                parameters=[file],
                additional_env=TIED,  # launch holds a pipe to their stdin
                on_exit=_on_exit(node.name, planned.rig, lost),
                output="screen",
                sigterm_timeout=STOP_TIMEOUT,
            )
            for node in planned.processes()
        ),
        *(
            ExecuteProcess(
                name="rig",
                cmd=[sys.executable, "-m", "koop_node.process.companion", *words],
                additional_env=TIED,
                on_exit=_on_exit("rig", planned.rig, lost),
                output="screen",
                sigterm_timeout=STOP_TIMEOUT,
            )
            for words in [planned.program]
            if words
        ),
    ]


def _on_exit(node: str, rig: bool, lost: list[str]):
    """Return what to do when a node ends.

    Parameters
    ----------
    node : str
        Its name.
    rig : bool
        Whether a rig is the plant.
    lost : list of str
        What went wrong while the launch went on; shared by all nodes.
    """

    def ended(event: ProcessExited, context: LaunchContext):
        text = told(node, event.returncode)
        found = ending(node, event.returncode, rig)
        # an error is how a launch gets an exit code; it also ends the other nodes
        if context.is_shutdown:
            if event.returncode or lost:
                raise RuntimeError(lost.pop() if lost else text)
        elif found is Ending.FAILED:
            raise RuntimeError(text)
        elif found is Ending.DONE:
            return [LogInfo(msg=text), EmitEvent(event=Shutdown(reason=text))]
        else:
            get_logger("launch").error(f"{text}: the loop goes on without it")
            lost.append(text)
        return None

    return ended
