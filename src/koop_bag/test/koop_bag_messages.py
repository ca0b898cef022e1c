"""Real messages, serialized by `rosbags`: it shares no code with this package."""

from __future__ import annotations

import dataclasses
import struct
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from koop_bag.cdr.schema import load_schema

LOOP = {
    "/state": "koop_msgs/msg/MeasuredState",
    "/cost": "koop_msgs/msg/Cost",
    "/theta": "koop_msgs/msg/ControlInput",
    "/ground_truth": "koop_msgs/msg/PlantTruth",
}
START = 1_700_000_000_000_000_000  # [ns]
PERIOD = 5_000_000  # [ns]


class Messages:
    """Makes and serializes messages of any installed type."""

    def __init__(self) -> None:
        self.store = get_typestore(Stores.ROS2_JAZZY)
        for name in LOOP.values():
            self.store.register(get_types_from_msg(load_schema(name).text.split("=" * 80)[0], name))

    def serialize(self, type_name: str, message: Any) -> bytes:
        """Return a message as DDS would hand it over."""
        return bytes(self.store.serialize_cdr(message, type_name))

    def make(self, type_name: str, **fields: Any) -> Any:
        """Return a message of a type."""
        return self.store.types[type_name](**fields)

    def header(self, k: int, frame_id: str = "") -> Any:
        """Return the header of step k."""
        sec, nanosec = divmod(k * PERIOD, 1_000_000_000)
        stamp = self.make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)

    def loop(self, topic: str, k: int, frame_id: str = "", model_id: str = "0123456789ab") -> bytes:
        """Return message k of one of the loop's topics; every value tells k."""
        fields: dict[str, Any] = {"header": self.header(k, frame_id), "step": k}
        if topic == "/state":
            fields["x"] = np.array([k + 0.25, -k - 0.5])
        elif topic == "/cost":
            fields |= {"r": k * 1.5, "y_out": k * 2.0, "source": k % 2, "model_id": model_id}
            fields |= {"dt": 0.005, "margin": k / 19}
        elif topic == "/theta":
            fields |= {"theta": np.array([-k / 7]), "epsilon": 1 - 2 * (k % 2)}
            fields |= {"cost_rise_filtered": k / 3, "saturated": k % 3 == 0, "holding": k % 5 == 0}
            fields |= {
                "swing": k / 13,
                "gradient": -k * 0.5,
                "noise": k + 0.5,
                "confidence": k / 17,
            }
        else:
            fields |= {"x": np.array([k, k * 2.0]), "epsilon0": k / 11}
            fields |= {"theta_applied": np.array([k / 9]), "theta_step": k - 1}
        flags = [
            f.name for f in dataclasses.fields(self.store.types[LOOP[topic]]) if f.type == "bool"
        ]
        fields = dict.fromkeys(flags, k % 7 == 0) | fields
        return self.serialize(LOOP[topic], self.make(LOOP[topic], **fields))


def padded(data: bytes) -> bytes:
    """Return a message as DDS hands it on: filled up to a multiple of four bytes."""
    return data + bytes(-len(data) % 4)


def step_of(data: bytes) -> int:
    """Return the step of a serialized message of the loop; struct.error if it has none."""
    (length,) = struct.unpack_from("<I", data, 12)  # of the frame, after encoding and stamp
    (step,) = struct.unpack_from("<Q", data, 4 + (12 + length + 7) // 8 * 8)
    return int(step)
