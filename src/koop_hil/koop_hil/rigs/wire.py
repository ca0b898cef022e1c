"""The messages of a rig, on Eclipse Cyclone DDS; shares no code with the nodes.

Nothing of ROS is here but the names and types on the wire.
"""

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

# On loopback, with peers found by unicast: nothing leaves the machine.
os.environ.setdefault(
    "CYCLONEDDS_URI",
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo'/></Interfaces>"
    "<AllowMulticast>spdp</AllowMulticast></General><Discovery><ParticipantIndex>auto"
    "</ParticipantIndex><MaxAutoParticipantIndex>60</MaxAutoParticipantIndex>"
    "<Peers><Peer Address='localhost'/></Peers></Discovery></Domain></CycloneDDS>",
)

try:
    from cyclonedds.core import Policy, Qos
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.idl import IdlStruct
    from cyclonedds.idl.types import array, float64, int8, int32, int64, sequence, uint32, uint64
    from cyclonedds.pub import DataWriter
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration
except ImportError as error:
    raise SystemExit(f"rig: {error}: pip install cyclonedds") from None

UNKNOWN = [-1.0] + [0.0] * 8  # covariance of what a sensor does not measure


@dataclass
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    stamp: Time
    frame_id: str


@dataclass
class MeasuredState(IdlStruct, typename="koop_msgs.msg.dds_.MeasuredState_"):
    header: Header
    step: uint64
    lockstep: bool  # a rig does not wait for answers: False
    x: sequence[float64]


@dataclass
class ControlInput(IdlStruct, typename="koop_msgs.msg.dds_.ControlInput_"):
    header: Header
    step: uint64
    theta: sequence[float64]
    epsilon: int8
    cost_rise_filtered: float64
    saturated: bool
    holding: bool
    swing: float64
    gradient: float64
    noise: float64
    confidence: float64


@dataclass
class PlantTruth(IdlStruct, typename="koop_msgs.msg.dds_.PlantTruth_"):
    header: Header
    step: uint64
    x: sequence[float64]
    theta_applied: sequence[float64]
    theta_step: int64
    epsilon0: float64


@dataclass
class Float64(IdlStruct, typename="std_msgs.msg.dds_.Float64_"):
    data: float64


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs.msg.dds_.Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs.msg.dds_.Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Imu(IdlStruct, typename="sensor_msgs.msg.dds_.Imu_"):
    header: Header
    orientation: Quaternion
    orientation_covariance: array[float64, 9]
    angular_velocity: Vector3
    angular_velocity_covariance: array[float64, 9]
    linear_acceleration: Vector3
    linear_acceleration_covariance: array[float64, 9]


@dataclass
class JointState(IdlStruct, typename="sensor_msgs.msg.dds_.JointState_"):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


def measured_state(header: Header, step: int, x: Sequence[float]) -> MeasuredState:
    """Return a sample in the loop's own type."""
    return MeasuredState(header, step, False, list(x))


def imu(header: Header, step: int, x: Sequence[float]) -> Imu:
    """Return rates [rad/s] and accelerations [m/s2] of a body, three each."""
    rates, accelerations = Vector3(*x[:3]), Vector3(*x[3:])
    level = Quaternion(0.0, 0.0, 0.0, 1.0)
    return Imu(header, level, UNKNOWN, rates, [0.0] * 9, accelerations, [0.0] * 9)


def joint_state(header: Header, step: int, x: Sequence[float]) -> JointState:
    """Return positions, each named by its index."""
    return JointState(header, list(map(str, range(len(x)))), list(x), [], [])


MESSAGES: dict[str, tuple[type, Callable[[Header, int, Sequence[float]], Any], type]] = {
    "MeasuredState": (MeasuredState, measured_state, ControlInput),
    "Imu": (Imu, imu, Float64),
    "JointState": (JointState, joint_state, Float64),
}
"""Type of the measurements, what makes one of header, step and values, and the command's type.

A ControlInput, which all take on the topic `theta`, names the step that it answers.
"""


class Wire:
    """Topics of one rig: of the measurements, of a type in :data:`MESSAGES`, and of each knob.

    With ``truth`` the true state of each sample is published, too.
    """

    def __init__(self, state: str, theta: Sequence[str], message: str, truth: bool) -> None:
        kind, self._made, command = MESSAGES[message]
        participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
        reliable = Policy.Reliability.Reliable(duration(seconds=1))
        kept = Qos(reliable, Policy.History.KeepLast(1000))
        newest = Qos(reliable, Policy.History.KeepLast(1))
        self._states = DataWriter(participant, Topic(participant, "rt/" + state, kind), kept)
        self._truths = None
        if truth:
            topic = Topic(participant, "rt/ground_truth", PlantTruth)
            self._truths = DataWriter(participant, topic, kept)
        types = [ControlInput if name == "theta" else command for name in theta]
        topics = [Topic(participant, f"rt/{name}", t) for name, t in zip(theta, types, strict=True)]
        self._commands = [DataReader(participant, topic, newest) for topic in topics]

    @property
    def readers(self) -> int:
        """Number of subscriptions to the measurements."""
        try:
            return len(self._states.get_matched_subscriptions())
        except IndexError:  # one came while Cyclone DDS counted
            return 0

    def say(
        self, stamp: int, step: int, x: Sequence[float], truth: Sequence[float],
        theta: Sequence[float], answered: int,
    ) -> None:  # fmt: skip
        """Publish one sample with its stamp [ns], and the true state."""
        header = Header(Time(stamp // 10**9, stamp % 10**9), "rig")
        self._states.write(self._made(header, step, x))
        if self._truths is not None:
            self._truths.write(PlantTruth(header, step, list(truth), theta, answered, math.nan))

    def heard(self) -> list[tuple[int, float, int | None]]:
        """Return the knobs' commands that came, and the step that each answers if it says that."""
        commands: list[tuple[int, float, int | None]] = []
        for knob, reader in enumerate(self._commands):
            for sample in reader.take(N=100):
                if isinstance(sample, ControlInput) and math.isfinite(sum(sample.theta)):
                    commands += [(i, value, sample.step) for i, value in enumerate(sample.theta)]
                elif isinstance(sample, Float64) and math.isfinite(sample.data):
                    commands.append((knob, sample.data, None))
        return commands
