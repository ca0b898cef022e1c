"""Parameters of knobs: one number for all, or one for each."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from koop_core.config.knobs import KnobSettings, format_knobs, read_knobs
from koop_core.config.parameter import ConfigError, parameter


@dataclass(frozen=True)
class Config(KnobSettings):
    low: float = parameter(-1.0, "limit", low=-5.0, high=5.0, per_knob=True)
    high: float = parameter(1.0, "limit", per_knob=True)
    time: float = parameter(3.0, "of all")


def test_one_number_is_of_all_knobs_and_a_list_has_one_for_each():
    config = Config(low=[-2, -3.0], high=4)
    assert (config.count, config.low, config.high) == (2, (-2.0, -3.0), 4.0)
    assert config.knobs(time=1.0) == [Config(-2.0, 4.0, 1.0), Config(-3.0, 4.0, 1.0)]


def test_a_list_of_one_is_the_number_itself():
    assert Config(low=[-2.0]) == Config(low=-2.0)
    assert Config(low=[-2.0]).count == 1


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"low": [0.0, 1.0], "high": [1.0, 2.0, 3.0]}, "one for each of at most 8 knobs"),
        ({"low": [0.0] * 9}, "one for each of at most 8 knobs"),
        ({"low": [0.0, 7.0]}, "low = 7: must be -5 to 5"),
        ({"low": []}, "low = nan: must be a finite number"),
        ({"low": ["a", "b"]}, "low: expected float"),
        ({"time": [1.0, 2.0]}, "time: expected float"),
    ],
)
def test_what_cannot_be_is_refused(values, message):
    with pytest.raises(ConfigError, match=message):
        Config(**values)


def test_what_is_written_is_read():
    for values in ([2.5], [0.1, -3.0, 1e-9]):
        assert read_knobs(format_knobs(values, "")) == values
