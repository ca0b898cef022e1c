"""Objects are read from JSON as they were written, or refused."""

import json
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from koop_core.json_object import from_json, to_json


class Pair(NamedTuple):
    """Two numbers, of which one may be infinite."""

    low: float
    high: float = math.inf


@dataclass(frozen=True)
class Whole:
    """One of each kind."""

    name: str
    pairs: tuple[Pair, ...]
    steps: tuple[int, int]
    values: list[float]
    array: NDArray[np.float64]
    maybe: Pair | None = None
    time: float | None = 1.0


WHOLE = Whole("a", (Pair(1.0), Pair(2.0, 3.0)), (0, 9), [0.1, math.inf], np.eye(2), None, None)


def test_an_object_is_read_as_it_was_written():
    text = json.dumps(to_json(WHOLE), allow_nan=False)
    read = from_json(Whole, json.loads(text))
    assert read.array.tolist() == [[1.0, 0.0], [0.0, 1.0]]
    assert read.__dict__ | {"array": 0} == WHOLE.__dict__ | {"array": 0}
    assert to_json({"pair": Pair(1)}) == {"pair": {"low": 1, "high": None}}
    assert from_json(Pair, {"low": 1}) == Pair(1.0, math.inf)


@pytest.mark.parametrize(
    "change",
    [
        {"nmae": "b"},  # an unknown key
        {"pairs": [{"high": 1.0}]},  # one that is missing
        {"pairs": 1},
        {"steps": [1]},
        {"values": ["x"]},
        {"maybe": [1.0, 2.0]},
    ],
)
def test_what_does_not_describe_an_object_is_refused(change):
    with pytest.raises((KeyError, TypeError, ValueError)):
        from_json(Whole, to_json(WHOLE) | change)
