"""The codec beside rclpy's own serialiser: random messages, bad bytes."""

import random
from array import array

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from koop_msgs.msg import ControlInput, Cost, MeasuredState, PlantTruth
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import UInt16MultiArray
from trajectory_msgs.msg import JointTrajectoryPoint

from koop_core.cdr import Walk
from koop_node.node import wire
from koop_node.node.wire import WireError, codec

KINDS = (MeasuredState, Cost, ControlInput, PlantTruth, JointTrajectoryPoint)
NUMBERS = {
    "boolean": lambda draw: draw.random() < 0.5,
    "double": lambda draw: draw.choice([draw.gauss(0.0, 1e3), float("inf"), -0.0, 5e-324]),
    "int8": lambda draw: draw.randint(-128, 127),
    "uint8": lambda draw: draw.randint(0, 255),
    "int32": lambda draw: draw.randint(-(2**31), 2**31 - 1),
    "uint32": lambda draw: draw.randint(0, 2**32 - 1),
    "int64": lambda draw: draw.randint(-(2**63), 2**63 - 1),
    "uint64": lambda draw: draw.randint(0, 2**64 - 1),
    "string": lambda draw: "".join(draw.choices("aä€😀 ", k=draw.randint(0, 12))),
}


def filled(draw, kind):
    """Return a message of random content."""
    message = kind()
    for name, of in kind.get_fields_and_field_types().items():
        if of in NUMBERS:
            setattr(message, name, NUMBERS[of](draw))
        elif of.startswith("sequence<"):
            inner = NUMBERS[of[9:-1]]
            setattr(message, name, [inner(draw) for _ in range(draw.randint(0, 7))])
        else:
            setattr(message, name, filled(draw, type(getattr(message, name))))
    return message


def as_typed(view, kind):
    """Return a message of the class with the fields of a codec's."""
    message = kind()
    for name, of in kind.get_fields_and_field_types().items():
        value = getattr(view, name)
        if "/" in of:
            value = as_typed(value, type(getattr(message, name)))
        setattr(message, name, value)
    return message


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_written_and_read_is_what_rclpy_writes_and_reads(kind):
    draw, wire = random.Random(kind.__name__), codec(kind)
    for _ in range(300):
        message = filled(draw, kind)
        data = serialize_message(message)
        view = wire.decode(data)
        assert as_typed(view, kind) == message
        for options in (view, message):
            written = wire.encode(options)
            assert deserialize_message(written, kind) == message
            assert len(written) <= len(data)  # rclpy may leave bytes at the end


def test_a_new_message_is_that_of_the_class():
    for kind in KINDS:
        assert as_typed(codec(kind).new(), kind) == kind()


def test_what_is_read_can_be_written_into():
    """The kernels are compiled for arrays that may be, as rclpy's are."""
    x = codec(MeasuredState).decode(serialize_message(MeasuredState(x=[1.0]))).x
    assert isinstance(x, array)
    x[0] = 2.0


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_bytes_are_read_or_refused_never_more(kind):
    draw, wire = random.Random(kind.__name__), codec(kind)
    refused = 0
    for _ in range(3000):
        data = bytearray(serialize_message(filled(draw, kind)))
        for _ in range(draw.randint(0, 3)):
            data[draw.randrange(len(data))] = draw.randint(0, 255)
        del data[draw.randint(0, len(data)) if draw.random() < 0.3 else len(data) :]
        try:
            wire.decode(bytes(data))
        except WireError:
            refused += 1
    assert 300 < refused < 2900


def test_lengths_that_change_for_ever_do_not_fill_the_memory():
    wire = codec(MeasuredState)
    for n in range(1000):
        view = wire.decode(serialize_message(MeasuredState(x=[0.0] * n)))
        assert len(view.x) == n
    assert len(wire._layouts) <= 101


@pytest.mark.parametrize("kind", [DiagnosticArray, UInt16MultiArray])
def test_a_message_of_messages_in_a_row_has_no_codec(kind):
    with pytest.raises(WireError, match="no codec for a field sequence<"):
        codec(kind)


def test_shorter_messages_after_a_longer_one_are_walked_over_once(monkeypatch):
    walks, states = [], wire.Codec(MeasuredState)
    monkeypatch.setattr(wire, "Walk", lambda data: walks.append(data) or Walk(data))
    for x in ([1.0] * 9, [2.0], [3.0], [4.0]):
        assert list(states.decode(states.encode(MeasuredState(x=x))).x) == x
    assert len(walks) == 2
