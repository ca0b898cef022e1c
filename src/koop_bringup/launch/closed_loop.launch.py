"""The closed loop: plant, lifter, controller and, on request, the recorder.

    ros2 launch koop_bringup closed_loop.launch.py pace:=lockstep duration:=100.0 record:=true

The launch ends when the plant has run for its duration. With ``plant:=false`` your own rig takes
the plant's place: it publishes ``state`` and listens to ``theta`` in the same namespace.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, GroupAction
from launch.conditions import IfCondition
from launch.events import Shutdown
from launch.substitutions import IfElseSubstitution, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node, PushRosNamespace
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PAPER = PathJoinSubstitution([FindPackageShare("koop_bringup"), "config", "paper.yaml"])
ARGUMENTS = (
    ("namespace", "", "namespace of the whole loop; a fleet is N namespaces"),
    ("params", PAPER, "ROS 2 parameter file for the nodes"),
    ("pace", "realtime", "realtime, lockstep or scaled"),
    ("time_scale", "1.0", "simulated per real time at the pace 'scaled'"),
    ("duration", "0.0", "simulated time in seconds after which the launch ends; 0: never"),
    ("cost", "lifted", "lifted or raw"),
    ("model", "", "Koopman model file; empty: the shipped one"),
    ("seed", "0", "seed of the plant's initial state"),
    ("plant", "true", "start the simulated plant; false: your rig is the plant"),
    ("record", "false", "record all topics"),
    ("output", "", "folder of the recording; empty: a new one under recordings/"),
)


def generate_launch_description() -> LaunchDescription:
    """Describe the launch."""
    given = {name: LaunchConfiguration(name) for name, _, _ in ARGUMENTS}
    params = given["params"]
    recorders = ParameterValue(
        IfElseSubstitution(given["record"], if_value="1", else_value="0"), value_type=int
    )
    plant = Node(
        package="vdp_plant",
        executable="plant",
        parameters=[
            params,
            {
                "pace": given["pace"],
                "time_scale": _number(given["time_scale"], float),
                "duration": _number(given["duration"], float),
                "seed": _number(given["seed"], int),
                "recorders": recorders,
            },
        ],
        condition=IfCondition(given["plant"]),
        on_exit=[EmitEvent(event=Shutdown(reason="the plant has ended"))],
        output="screen",
    )
    lifter = Node(
        package="koopman_lifter",
        executable="lifter",
        parameters=[
            params,
            {
                "cost": given["cost"],
                "model": ParameterValue(given["model"], value_type=str),
                "recorders": recorders,
            },
        ],
        output="screen",
    )
    esc = Node(
        package="relay_esc",
        executable="esc",
        parameters=[params, {"recorders": recorders}],
        output="screen",
    )
    recorder = Node(
        package="koop_bag",
        executable="recorder",
        parameters=[{"output": ParameterValue(given["output"], value_type=str)}],
        condition=IfCondition(given["record"]),
        output="screen",
    )
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=text)
                for name, default, text in ARGUMENTS
            ),
            GroupAction([PushRosNamespace(given["namespace"]), recorder, esc, lifter, plant]),
        ]
    )


def _number(value: LaunchConfiguration, kind: type) -> ParameterValue:
    return ParameterValue(value, value_type=kind)
