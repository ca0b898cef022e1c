"""Bytes are found out before they reach code that allocates what a length word says."""

from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from koop_bag.cdr.definition import parse_definition
from koop_bag.cdr.schema import load_schema
from koop_core.cdr import CdrError, check_message

NAME = "diagnostic_msgs/msg/DiagnosticArray"  # strings in structures in sequences
KIND = parse_definition(NAME, load_schema(NAME).text)
STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = STORE.types


def written(words):
    """Return a message as another package writes it."""
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=1, nanosec=2)
    pairs = [TYPES["diagnostic_msgs/msg/KeyValue"](key=w, value=w * 2) for w in words]
    status = TYPES["diagnostic_msgs/msg/DiagnosticStatus"]
    message = TYPES[NAME](
        header=TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id="f"),
        status=[status(level=1, name=w, message="", hardware_id="", values=pairs) for w in words],
    )
    return bytes(STORE.serialize_cdr(message, NAME))


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9), max_size=4)
)
def test_a_message_passes_and_none_that_is_cut_short(words):
    data = written(words)
    check_message(KIND, data)
    for length in range(0, len(data), 17):
        with pytest.raises(CdrError):
            check_message(KIND, data[:length])


@settings(max_examples=30, deadline=None)
@given(st.binary(max_size=80))
def test_any_bytes_pass_or_are_refused(data):
    for given_bytes in (data, b"\0\1\0\0" + data):
        with suppress(CdrError):
            check_message(KIND, given_bytes)


def test_a_length_beyond_the_message_is_refused_at_once():
    head = b"\0\1\0\0" + bytes(8) + b"\1\0\0\0\0" + bytes(3)
    check_message(KIND, head + bytes(4))
    with pytest.raises(CdrError):
        check_message(KIND, head + b"\xff\xff\xff\x7f" + bytes(100))
