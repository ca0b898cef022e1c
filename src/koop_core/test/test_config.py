"""Configuration classes that validate themselves."""

from dataclasses import dataclass

import numpy as np
import pytest

from koop_core.config.parameter import ConfigError, NodeConfig, Settings, parameter


@dataclass(frozen=True)
class Example(Settings):
    gain: float = parameter(1.0, "a gain", unit="1/s", low=0.0, high=10.0)
    count: int = parameter(3, "a count", low=1)
    mode: str = parameter("a", "a mode", choices=("a", "b"))
    limits: tuple[float, ...] = parameter((0.0, 1.0), "limits", low=-1.0, high=1.0)
    enabled: bool = parameter(True, "a switch", read_only=True)


def test_defaults_are_valid():
    assert Example() == Example(1.0, 3, "a", (0.0, 1.0), True)
    NodeConfig()


def test_what_yaml_and_numpy_write_is_converted():
    config = Example(gain=2, count=np.int64(4), limits=[0, np.float32(0.5)])
    assert config == Example(2.0, 4, limits=(0.0, 0.5))
    assert type(config.count) is int
    assert {type(value) for value in config.limits} == {float}


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"gain": 11.0}, "gain = 11: must be 0 to 10 1/s"),
        ({"gain": float("inf")}, "gain = inf: must be a finite number"),
        ({"gain": 10**400}, "gain = inf: must be a finite number"),
        ({"count": 10**400}, "count: an integer of more than 64 bits"),
        ({"mode": "\x1b[31m\n"}, "mode = '\\x1b[31m\\n': must be one of a, b"),
        ({"gain": True}, "gain: expected float, got True (bool)"),
        ({"gain": None}, "gain: expected float, got None (NoneType)"),
        ({"count": 0}, "count = 0: must be at least 1"),
        ({"count": 1.0}, "count: expected int, got 1.0 (float)"),
        ({"mode": "c"}, "mode = 'c': must be one of a, b"),
        ({"limits": (0.0, 2.0)}, "limits = 2: must be -1 to 1"),
        ({"limits": "01"}, "limits: expected a list of numbers, got '01'"),
        ({"limits": 1.0}, "limits: expected a list of numbers, got 1.0"),
        ({"enabled": 1}, "enabled: expected bool, got 1 (int)"),
    ],
)
def test_what_cannot_be_used_is_refused_by_name(values, message):
    with pytest.raises(ConfigError) as caught:
        Example(**values)
    assert str(caught.value) == message
