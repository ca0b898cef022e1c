"""What a client sends is a request or refused in words, whatever it is."""

import json
import struct
from contextlib import suppress
from datetime import date

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from koop_view import protocol
from koop_view.protocol import ProtocolError, parse

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=4,
)
OPERATIONS = st.sampled_from([
    "subscribe", "unsubscribe", "getParameters", "setParameters", "subscribeParameterUpdates",
    "advertise", "fetchAsset", "serverInfo", "",
])  # fmt: skip
KEYS = ("subscriptions", "subscriptionIds", "parameterNames", "parameters", "id")
MESSAGES = st.builds(
    lambda operation, content: json.dumps({"op": operation, **content}),
    OPERATIONS,
    st.dictionaries(st.sampled_from(KEYS), JSON),
)
CALLS = st.builds(
    lambda head, rest: struct.pack("<B", head) + rest, st.integers(0, 3), st.binary(max_size=40)
)


@settings(max_examples=30, deadline=None)
@given(MESSAGES | JSON.map(json.dumps) | st.text() | CALLS | st.binary())
def test_any_message_is_a_request_or_is_refused(message):
    with suppress(ProtocolError):
        assert isinstance(parse(message), protocol.Request)


@pytest.mark.parametrize("text", ["[" * 100_000, '{"op":"subscribe","subscriptions":1e999}',
                                  '{"op":"getParameters","parameterNames":[NaN]}',
                                  '{"op":"unsubscribe","subscriptionIds":[true]}',
                                  "1" * 5000])  # fmt: skip
def test_malicious_messages_are_refused(text):
    with pytest.raises(ProtocolError):
        parse(text)


def test_a_call_is_read_and_one_cut_short_refused():
    message = struct.pack("<BIII", 2, 7, 9, 3) + b"cdr" + b"payload"
    assert parse(message) == protocol.Call(7, 9, "cdr", b"payload")
    with pytest.raises(ProtocolError):
        parse(struct.pack("<BIII", 2, 7, 9, 30) + b"cdr")


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ([1.0, 2.0], {"value": [1.0, 2.0]}),
        (float("inf"), {"value": "inf"}),  # JSON has no word for it
        (date(2026, 1, 2), {"value": "2026-01-02"}),  # as YAML reads the record of a bag
        ({"a": [float("nan")]}, {"value": "{'a': [nan]}"}),
        (None, {}),
    ],
)
def test_a_parameter_is_json_whatever_its_value(value, said):
    text = protocol.parameter_values({"/n.p": value}, None)
    assert json.loads(text)["parameters"] == [{"name": "/n.p", **said}]
