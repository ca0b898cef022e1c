"""Messages that compiled code takes and publishes, over DDS, beside what rclpy takes."""

import random
import struct
import time
from functools import partial

import numpy as np
import pytest
import rclpy
from koop_msgs.msg import ControlInput, Cost, MeasuredState
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message

from koop_core.port import IDLE, OTHER, PLAIN, copy_header, floats, receive, send, word
from koop_node.node.memory import CAPACITY, Memory
from koop_node.node.wire import LITTLE, codec

DEPTH = QoSProfile(depth=1000)


def state(step=7, x=(1.5, -2.5), frame_id="rig"):
    message = MeasuredState(step=step, x=list(x), lockstep=True)
    message.header.frame_id = frame_id
    message.header.stamp.sec = 12
    return message


def wait_for(look):
    """Return what ``look`` returns once it is true; every reason of a port but IDLE is."""
    deadline = time.monotonic() + 60.0
    while not (result := look()):
        assert time.monotonic() < deadline
    return result


@pytest.fixture
def ends(own_domain):
    """A publisher and a subscription of states that have found each other."""
    context = rclpy.Context()
    context.init(args=[])
    node = Node("ends", context=context)
    publisher = node.create_publisher(MeasuredState, "state", DEPTH)
    subscription = node.create_subscription(
        MeasuredState, "state", lambda message: None, DEPTH, raw=True
    )
    wait_for(publisher.get_subscription_count)
    yield publisher, subscription
    node.destroy_node()
    context.shutdown()


@pytest.mark.parametrize("kind", [MeasuredState, Cost, ControlInput])
def test_every_value_lies_where_rclpys_serialiser_puts_it(kind):
    message = kind()
    own = codec(kind)
    for sizes in (0, 1, 3):
        message.header.frame_id = "f" * (2 * sizes + 1)
        for name, field in kind.get_fields_and_field_types().items():
            if field == "sequence<double>":
                setattr(message, name, [0.25 * i for i in range(1, sizes + 1)])
        message.step = 0x0102030405060708
        data = serialize_message(message)
        places = own.places(data)
        assert places.size <= len(data)  # rclpy's may end with padding
        assert struct.unpack_from("<Q", data, places.at["step"]) == (message.step,)
        at = places.at["header.frame_id"]
        assert data[at : at + len(message.header.frame_id)] == message.header.frame_id.encode()
        for name in ("x", "theta"):
            if sizes and name in places.at:
                values = struct.unpack_from(f"<{sizes}d", data, places.at[name])
                assert list(values) == list(getattr(message, name))
        for at, length in places.guards.tolist():
            assert struct.unpack_from("<I", data, at) == (length,)


def test_compiled_code_reads_and_writes_what_rclpy_does(ends):
    publisher, subscription = ends
    own, names = codec(MeasuredState), ("step", "x")
    inbox, outbox = Memory(), Memory()
    data = own.encode(state())
    outbox.write(data)
    taking = inbox.port(subscription, own.places(data), names)
    giving = outbox.port(publisher, own.places(data), names)
    assert receive(taking) == IDLE

    publisher.publish(state(step=8, x=(3.0, 4.0)))
    assert wait_for(partial(receive, taking)) == PLAIN
    assert word(taking, 0)[0] == 8
    assert floats(taking, 1, 2).tolist() == [3.0, 4.0]

    assert copy_header(taking, giving)
    word(giving, 0)[0] = 9
    floats(giving, 1, 2)[:] = (5.0, 6.0)
    assert send(giving)
    assert wait_for(partial(receive, taking)) == PLAIN
    taken = deserialize_message(inbox.read(), MeasuredState)
    assert taken == state(step=9, x=(5.0, 6.0))

    publisher.publish(state(frame_id="rug"))
    assert wait_for(partial(receive, taking)) == PLAIN
    assert not copy_header(taking, giving)  # another frame's text is Python's to read


def test_what_is_laid_out_otherwise_torn_or_too_large_is_pythons(ends):
    publisher, subscription = ends
    own = codec(MeasuredState)
    plain = own.encode(state())
    inbox = Memory()
    draw = random.Random(5)
    odd = [
        b"", b"\0", LITTLE, plain[:-1], plain[:20],
        b"\0\0" + plain[2:], serialize_message(state(frame_id="other")),
        serialize_message(state(x=())),
    ]  # fmt: skip
    odd += [serialize_message(state(x=[1.0] * n)) for n in (600, 900, CAPACITY)]  # grow in place
    odd += [draw.randbytes(draw.randrange(3 * len(plain))) for _ in range(300)]
    for data in odd:
        # anew: the memory may lie elsewhere after a message that did not fit
        port = inbox.port(subscription, own.places(plain), ("step",))
        publisher.publish(data)
        assert wait_for(partial(receive, port)) == OTHER
        assert inbox.read() == data
        publisher.publish(plain)
        port = inbox.port(subscription, own.places(plain), ("step",))
        assert wait_for(partial(receive, port)) == PLAIN
    with pytest.raises(ValueError, match="does not fit"):
        Memory().write(bytes(CAPACITY + 1))
    assert np.array_equal(inbox.read(), plain)
