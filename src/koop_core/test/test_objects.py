"""Objects are read from JSON as they were written, or refused."""

import json
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from koop_core.config.objects import parse, to_json
from koop_core.config.parameter import ConfigError


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


ENDS = np.diag([math.inf, -math.inf])
WHOLE = Whole("a", (Pair(-math.inf), Pair(2.0, 3.0)), (0, 9), [0.1, math.inf], ENDS, None, math.inf)


def test_an_object_is_read_as_it_was_written():
    text = json.dumps(to_json(WHOLE), allow_nan=False)
    read = parse(Whole, json.loads(text), "it")
    assert read.array.tolist() == [[math.inf, 0.0], [0.0, -math.inf]]
    assert read.__dict__ | {"array": 0} == WHOLE.__dict__ | {"array": 0}
    assert to_json({"pair": Pair(1)}) == {"pair": {"low": 1, "high": "inf"}}
    assert parse(Pair, {"low": 1}, "it") == Pair(1.0, math.inf)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"nmae": "b"}, "unknown key 'nmae': did you mean 'name'"),
        ({"name": 1}, "name: expected str, got 1"),
        ({"pairs": [{"high": 1.0}]}, r"pairs\[0\]: 'low' is missing"),
        ({"pairs": 1}, "pairs: expected a list, got 1"),
        ({"steps": [1]}, "steps: expected 2 values, got 1"),
        ({"values": ["x"]}, r"values\[0\]: expected float, got 'x'"),
        ({"values": [10**400]}, r"values\[0\]: the number is too large"),
        ({"array": [[1.0], [1.0, 2.0]]}, "array: expected numbers"),
        ({"array": [10**400]}, "array: expected numbers"),
        ({"maybe": [1.0, 2.0]}, "maybe must be a mapping"),
    ],
)
def test_what_does_not_describe_an_object_is_refused_with_the_reason(change, reason):
    with pytest.raises(ConfigError, match=f"it: {reason}"):
        parse(Whole, to_json(WHOLE) | change, "it")
