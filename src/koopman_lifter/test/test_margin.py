"""The margin of a constraint: its statistics beside their definitions, and what has none."""

import math

import numpy as np
import pytest

from koop_core.config.constraint import parse_constraint
from koop_core.config.parameter import ConfigError
from koop_core.stream.arrival import Arrival
from koopman_lifter import margin

DT, WINDOW, BOUND = 0.01, 0.5, 2.0


def margins(statistic, values, arrivals=None):
    """Return the margin at each value."""
    p = margin.margin_params(parse_constraint(f"{statistic}(/a:x, {WINDOW} s) < {BOUND}"), DT)
    state, left = margin.BEGIN, []
    for k, value in enumerate(values):
        arrival = Arrival.NEXT if arrivals is None else arrivals[k]
        one, state = margin.follow(p, state, int(arrival), float(value), 1.0)
        left.append(one)
    return np.array(left)


def test_the_rms_of_a_sine_leaves_what_its_amplitude_says():
    t = np.arange(2000) * DT
    left = margins("rms", 3.0 * math.sqrt(2.0) * np.sin(2.0 * np.pi * 20.0 * t))
    assert np.isnan(left[: round(WINDOW / DT) - 1]).all()
    np.testing.assert_allclose(left[round(WINDOW / DT) :], 1.0 - 3.0 / BOUND, atol=0.02)


def test_a_step_is_forgotten_with_the_window_as_time_constant():
    values = np.r_[np.full(500, 1.5), np.full(500, 0.5)]
    squares = ((1.0 - margins("rms", values)) * BOUND) ** 2
    t = (np.arange(500) + 1) * DT
    np.testing.assert_allclose(squares[500:], 0.25 + 2.0 * np.exp(-t / WINDOW), rtol=1e-9)


def test_the_peak_is_the_largest_of_one_to_two_windows():
    values = np.random.default_rng(0).standard_normal(1000)
    n = round(WINDOW / DT)
    statistic = (1.0 - margins("peak", values)) * BOUND
    for k in range(n, 1000):
        most, least = (np.abs(values[max(0, k + 1 - m) : k + 1]).max() for m in (2 * n, n))
        assert least <= statistic[k] <= most


@pytest.mark.parametrize("wild", [np.nan, 1e200])  # the second failed: no margin ever again
@pytest.mark.parametrize("statistic", ["rms", "peak"])
def test_a_gap_or_a_start_begins_anew(statistic, wild):
    values, n = np.ones(300), round(WINDOW / DT)
    values[100] = wild
    arrivals = [Arrival.NEXT] * 300
    arrivals[200] = Arrival.JOIN
    left = margins(statistic, values, arrivals)
    for begin in (0, 101, 200):
        assert np.isnan(left[begin : begin + n - 1]).all()
        assert left[begin + n] == 0.5


def test_what_came_between_two_states_counts_and_silence_ends():
    signal = margin.SignalMeter(parse_constraint("rms(/a:x, 0.05 s) < 1"), DT)
    assert math.isnan(signal.take()[0])
    signal.hear(3.0)
    signal.hear(-4.0)
    assert signal.take() == (pytest.approx(math.sqrt(12.5)), 1.0)
    assert [signal.take() for _ in range(4)] == [(0.0, 0.0)] * 4  # it is slower than the state
    assert math.isnan(signal.take()[0])
    peak = margin.SignalMeter(parse_constraint("peak(/a:x, 0.05 s) < 1"), DT)
    peak.hear(-4.0)
    peak.hear(3.0)
    assert peak.take()[0] == 4.0
    peak.hear(math.nan)
    peak.hear(1.0)
    assert math.isnan(peak.take()[0])


def heard(statistic, bound, events, signal):
    """Return the margins where values of a signal, "v", and states, "s", come in an order."""
    constraint = parse_constraint(f"{statistic}(/a:x, {WINDOW} s) < {bound}")
    p, state, left = margin.margin_params(constraint, DT), margin.BEGIN, []
    meter, values = margin.SignalMeter(constraint, DT), iter(signal)
    for event in events:
        if event == "v":
            meter.hear(next(values))
            continue
        one, state = margin.follow(p, state, int(Arrival.NEXT), *meter.take())
        left.append(one)
    return np.array(left)


@pytest.mark.parametrize("stall", ["v" * 20 + "s" * 20, "s" * 20 + "v" * 20])
@pytest.mark.parametrize("steady", [0, 7, 100])
def test_a_signal_within_its_bound_is_within_it_where_messages_come_in_bursts(stall, steady):
    """Failed: the last value before 20 states was counted 20 times."""
    events = ("vs" * steady + stall) * (4000 // (steady + 20))
    t = np.arange(events.count("v")) * DT
    for phase in np.linspace(0.0, 2.0 * np.pi, 7):
        sine = math.sqrt(2.0) * np.sin(2.0 * np.pi * 21.0 * t + phase)
        left = heard("rms", 1.2, events, sine)[2 * round(WINDOW / DT) :]
        # the 20 values of a burst, of 4.2 periods, weigh at most exp(0.4) times those before
        np.testing.assert_allclose(left, 1.0 - 1.0 / 1.2, atol=0.05)
        assert (heard("peak", 1.5, events, sine)[100:] > 0.0).all()


@pytest.mark.parametrize("events", ["vssss", "vs", "vvvvs"])
def test_a_slower_or_a_faster_signal_is_forgotten_at_the_same_rate(events):
    states, values = events.count("s"), events.count("v")
    step = np.repeat([1.5, 0.5], 400 // states * values)
    left = heard("rms", BOUND, events * (800 // states), step)
    t = (np.arange(400) + 1) * DT
    expected = 0.25 + 2.0 * np.exp(-t / WINDOW)
    # a value of every fourth state: the statistic of all four is told at the first of them
    late = 2.0 * -math.expm1(-(states - 1) * DT / WINDOW)
    np.testing.assert_allclose(((1.0 - left[400:]) * BOUND) ** 2, expected, atol=late + 1e-9)


@pytest.mark.parametrize(
    "text",
    ["mean(/a:x, 1 s) < 2", "rms(/a:x) < 2", "rms(/a:x, 1 s) > 2", "rms(/a:x, -1 s) < 2",
     "rms(/a:x, 1 s) < 0", "rms(/a:x, nan s) < 2", "rms(/a:x, 1 s) < two", "rms(a b:x, 1) < 2"],
)  # fmt: skip
def test_what_is_no_constraint_is_refused(text):
    with pytest.raises(ConfigError):
        parse_constraint(text)
