"""Bags of an oscillator whose operator is known, written by another library."""

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from koop_identify.recording.samples import recorded_source

DT = 0.02
A = np.array([[-0.1, 2.0], [-2.0, -0.1]])  # a damped oscillation, 2 rad/s
JOINTS = recorded_source("/joint_states:position[1],velocity[1]")
STORE = get_typestore(Stores.ROS2_JAZZY)


def oscillation(t, phase=0.0):
    """x(t) of x' = A x from [cos, sin] of the phase, shape (2, len(t)): it turns and decays."""
    t = np.asarray(t)
    x = np.exp(-0.1 * t) * [np.cos(phase - 2.0 * t), np.sin(phase - 2.0 * t)]
    return np.asfortranarray(x)  # a sample is written at a time


def write_numbers(writer, topic, times, values):
    """Add a topic of std_msgs/Float64."""
    kind = "std_msgs/msg/Float64"
    connection = writer.add_connection(topic, kind, typestore=STORE)
    for at, value in zip(times, values, strict=True):
        message = STORE.types[kind](data=float(value))
        writer.write(connection, int(at), STORE.serialize_cdr(message, kind))


def write_joints(path, t, x, theta=None, begin=1_700_000_000):
    """Write a bag of sensor_msgs/JointState with another library; the state is joint 1 of two.

    ``theta`` of every sample becomes a number on /knob where it changes, without a stamp.
    """
    types, plugin = STORE.types, StoragePlugin.MCAP
    header, stamp = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        kind = "sensor_msgs/msg/JointState"
        topic = writer.add_connection("/joint_states", kind, typestore=STORE)
        for time, (position, velocity) in zip(t, x.T, strict=True):
            at = round(time * 1e9)
            message = types[kind](
                header=header(stamp(begin + at // 10**9, at % 10**9), "rig"),
                name=["first", "second"],
                position=np.array([9.0, position]),
                velocity=np.array([9.0, velocity]),
                effort=np.array([]),
            )
            late = at + begin * 10**9 + 300_000
            writer.write(topic, late, STORE.serialize_cdr(message, kind))
        if theta is not None:
            turned = np.flatnonzero(np.diff(theta, prepend=np.nan) != 0.0)
            times = begin * 10**9 + np.round(t[turned] * 1e9).astype(np.int64)
            write_numbers(writer, "/knob", times, theta[turned])
    return path


def received(t, rng, size=1.0):
    """Return when samples of times t [s] are received: late, at times in a batch, in order."""
    late = size * 0.2 * DT * rng.exponential(size=t.size)
    busy = rng.random(t.size) < 0.01 * size  # the host has something else to do, for up to 20 Dt
    busy[-100:] = False  # a recording that ends meanwhile has a gap there
    late[busy] += 20.0 * DT * rng.random(np.count_nonzero(busy))
    return np.maximum.accumulate(t + late + 1e-6 * np.arange(t.size))


def write_unstamped(path, at, x, begin=1_700_000_000):
    """Write a bag of std_msgs/Float64MultiArray, which bears no stamp."""
    types, kind = STORE.types, "std_msgs/msg/Float64MultiArray"
    layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topic = writer.add_connection("/adc", kind, typestore=STORE)
        for time, values in zip(at, x.T, strict=True):
            message = STORE.serialize_cdr(types[kind](layout=layout, data=values), kind)
            writer.write(topic, begin * 10**9 + round(time * 1e9), message)
    return path
