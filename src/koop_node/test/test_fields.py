"""Field expressions and step counting for rigs that speak standard messages."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from koop_core.config.fields import (
    check_fields,
    check_type,
    format_field,
    numbers_of,
    parse_field,
    parse_source,
    read_field,
    write_field,
)
from koop_core.config.parameter import ConfigError
from koop_node.node.adapter import StateAdapter, StepCounter

DT = 0.005


def message(stamp=0.0, **fields):
    sec, rest = divmod(stamp, 1.0)
    header = SimpleNamespace(stamp=SimpleNamespace(sec=int(sec), nanosec=round(rest * 1e9)))
    return SimpleNamespace(header=header, **fields)


def test_a_source_names_topic_and_fields():
    source = parse_source("/joint_states:position[0], velocity[12]")
    assert source.topic == "/joint_states"
    assert source.fields == ((("position", 0),), (("velocity", 12),))
    assert parse_field("twist.linear.x") == (("twist", None), ("linear", None), ("x", None))


@pytest.mark.parametrize(
    "text",
    [
        "", ":", "/a", "/a:", "/a:x,", "/a:x y", "a b:x", "/a:x[]", "/a:x[-1]", "/a:x[01]",
        "/a:x[1e3]", "/a:x[0][1]", "/a:__class__", "/a:x.__init__", "/a:_private", "/a:x()",
        "/a:x[9999999]", "/a:x;y", "/a:" + ".".join("x" * 21), "/a:" + ",".join(["x"] * 65),
        "/a:x\n.y", "/ä:x", "/a:x[٣]", "//a:x", "/a/:x",
    ],
)  # fmt: skip
def test_anything_else_is_refused_and_named(text):
    with pytest.raises(ConfigError):
        parse_source(text)


@pytest.mark.parametrize(
    "text", ["", "JointState", "a/msg/b", "a/srv/B", "os/msg/X;y", "a/msg/B/c"]
)
def test_a_type_is_a_package_and_a_message(text):
    with pytest.raises(ConfigError):
        check_type(text)


@pytest.mark.parametrize(
    "text", ["x", "position[0]", "header.stamp.sec", "status[3].values[12].key"]
)
def test_a_field_is_written_as_it_was_read(text):
    assert format_field(parse_field(text)) == text


def test_numbers_are_read_and_what_is_none_is_nan():
    sample = message(position=[1.5, 2.5], twist=SimpleNamespace(x=3), name=["left"])
    assert read_field(parse_field("position[1]"), sample) == 2.5
    assert read_field(parse_field("twist.x"), sample) == 3.0
    for text in ("position[2]", "position", "name[0]", "twist.y", "twist[0]", "twist.x.real[0]"):
        assert math.isnan(read_field(parse_field(text), sample))


def test_an_array_of_fixed_length_holds_numbers_too():
    """Messages hold such arrays in numpy's types; found by fuzzing: all was NaN but float64."""
    for kind in (np.float32, np.float64, np.uint8, np.int32):
        sample = message(gyro=np.array([0, 1], kind))
        check_fields((parse_field("gyro[1]"),), sample)
        assert read_field(parse_field("gyro[1]"), sample) == 1.0


def test_fields_are_checked_before_the_first_message():
    empty = message(position=[], twist=SimpleNamespace(x=0.0), name="")
    check_fields((parse_field("position[3]"), parse_field("twist.x")), empty)
    for text in ("effort[0]", "position", "twist.x[0]", "twist", "name", "name[0]"):
        with pytest.raises(ConfigError):
            check_fields((parse_field(text),), empty)


def steps(stamps):
    counter = StepCounter(DT)
    return [counter.next(stamp) for stamp in stamps]


def test_steps_follow_the_stamps_over_jitter_drift_and_losses():
    drift = 1.0002
    stamps = [100.0 + k * DT * drift + (0.0015 if k % 2 else 0.0) for k in range(20_000)]
    assert steps(stamps) == list(range(1, 20_001))
    assert steps([100.0, 100.005, 100.020, 100.025]) == [1, 2, 5, 6]


def test_a_source_faster_than_the_steps_is_noticed_and_jitter_is_not():
    counter = StepCounter(DT)
    for k in range(1000):
        counter.next(100.0 + k * DT + (0.002 if k % 2 else 0.0))
    assert counter.early == 0
    for k in range(1000):
        counter.next(200.0 + k * DT / 4)
    assert counter.early == 999


def test_repeated_overtaken_and_restarted_stamps():
    assert steps([50.0, 50.005, 50.005, 50.015, 50.010, 50.020]) == [1, 2, 2, 4, 3, 5]
    assert steps([50.0, 50.005, 1.0, 1.005]) == [1, 2, 1, 2]


def test_without_stamps_every_message_is_the_next_step():
    assert steps([0.0] * 4) == [1, 2, 3, 4]


def test_a_source_that_stamps_only_some_messages_makes_no_gaps():
    """As a driver before it knows the time, which counted as billions of lost messages."""
    assert steps([0.0, 0.0, 1e9, 1e9 + DT, 1e9 + 3 * DT]) == [1, 2, 3, 4, 6]
    assert steps([1e9, 1e9 + DT, 0.0, 1e9 + 3 * DT]) == [1, 2, 3, 4]


def test_the_adapter_makes_states():
    adapter = StateAdapter(parse_source("/js:position[0],velocity[0]"), DT)
    assert adapter.convert(message(9.0, position=[1.0], velocity=[2.0])) == (1, [1.0, 2.0])
    step, values = adapter.convert(message(9.01, position=[1.0], velocity=[]))
    assert step == 3
    assert values[0] == 1.0
    assert math.isnan(values[1])


@pytest.mark.parametrize("header", [None, SimpleNamespace(), SimpleNamespace(stamp=5.0)])
def test_a_header_of_another_kind_is_no_stamp(header):
    adapter = StateAdapter(parse_source("/js:x"), DT)
    assert adapter.convert(SimpleNamespace(header=header, x=1.0)) == (1, [1.0])


class Made(SimpleNamespace):
    """Like a message: it knows its fields."""

    def get_fields_and_field_types(self):
        return vars(self)


def test_the_numbers_of_a_message_are_all_but_what_says_when():
    inner = Made(x=1.0, name="a", ok=True)
    whole = Made(header=Made(stamp=Made(sec=1)), step=3, gain=2, axes=[1.0, 2.0], twist=[inner])
    actual = [format_field(path) for path in numbers_of(whole)]
    assert actual == ["gain", "axes[0]", "axes[1]", "twist[0].x"]


@pytest.mark.parametrize("text", ["gain", "axes[3]", "twist.x", "count"])
def test_what_is_written_into_a_field_is_read_there(text):
    options = SimpleNamespace(gain=0.0, count=0, axes=[1.0], twist=SimpleNamespace(x=0.0))
    write_field(parse_field(text), options, 7.0)
    assert read_field(parse_field(text), options) == 7.0
