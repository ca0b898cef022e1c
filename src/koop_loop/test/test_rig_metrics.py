"""The metrics of a rig against oscillations and thetas that are known."""

import numpy as np
import pytest

from koop_loop.rig_metrics import rig_metrics

DT = 0.01
T = np.arange(20_000) * DT  # 200 s


def damped(before=3.0, after=0.6, until=60.0, omega=6.0):
    """Two channels whose amplitude falls linearly until a time, then stays."""
    size = np.interp(T, [0.0, until], [before, after])
    return np.stack((size * np.sin(omega * T), 2.0 * size * np.cos(omega * T)), axis=1)


def triangle(t, period=40.0, size=0.5):
    return size * (4.0 * np.abs((t / period) % 1.0 - 0.5) - 1.0)


def approach(end=60.0):
    """Theta falls from 2 to -3 until a time, then cycles around -3."""
    return np.where(end > T, 2.0 - 5.0 * T / end, -3.0 + triangle(T - end - 30.0))


def test_amplitudes_before_and_after_and_their_reduction():
    metrics = rig_metrics(T, damped(), approach())
    # in the first 8 s the amplitude falls by 11 %
    assert metrics.before == pytest.approx((2.84, 5.68), rel=0.02)
    assert metrics.after == pytest.approx((0.6, 1.2), rel=0.01)
    assert metrics.reduction == pytest.approx((0.789, 0.789), abs=0.01)
    assert (metrics.before_from, metrics.before_to) == pytest.approx((0.0, 8.0))
    assert (metrics.after_from, metrics.after_to) == pytest.approx((140.0, 200.0))


def test_before_lasts_until_theta_first_moves():
    x = damped(until=0.1)
    x[T < 50.0] = damped(after=3.0)[T < 50.0]
    theta = np.where(T < 20.0, np.nan, np.where(T < 50.0, 2.0, 2.0 - 0.1 * (T - 50.0)))
    metrics = rig_metrics(T, x, theta)
    assert metrics.before_to == pytest.approx(50.01)
    assert metrics.before == pytest.approx((3.0, 6.0), rel=0.01)


def test_what_is_before_ends_where_the_end_begins():
    metrics = rig_metrics(T, damped(), np.where(T < 180.0, 2.0, -3.0))
    assert metrics.before_to == metrics.after_from == pytest.approx(140.0)


def test_the_window_is_five_periods_of_the_strongest_oscillation():
    omega = 2.0 * np.pi / 3.0
    metrics = rig_metrics(T, damped(omega=omega), None)
    assert metrics.window == pytest.approx(15.0, rel=0.07)  # a bin of the spectrum is 1 / 50 s
    assert rig_metrics(T, damped(omega=100.0), None).window == pytest.approx(8.0)


def test_theta_settles_when_it_comes_into_its_final_swing():
    metrics = rig_metrics(T, damped(), approach())
    # the swing is -3.5 to -2.5, widened by 0.1: reached at 2 - 5 t / 60 = -2.4
    assert metrics.settled_at == pytest.approx(52.8, abs=0.05)
    assert metrics.theta_mean == pytest.approx((-3.0,), abs=0.1)
    assert metrics.theta_swing == pytest.approx((1.0,), abs=0.01)


@pytest.mark.parametrize(
    "theta",
    [2.0 - T / 40.0, 2.0 - T / 40.0 + 0.1 * np.sin(T), np.where(T < 150.0, 2.0, -3.0)],
    ids=["ramp", "ramp with a cycle", "late step"],
)
def test_theta_that_still_goes_somewhere_has_not_settled(theta):
    assert rig_metrics(T, damped(), theta).settled_at is None


def test_theta_that_rests_has_settled_from_the_start_and_its_time_at_the_limit_is_told():
    theta = np.full(T.size, -5.0)
    metrics = rig_metrics(T, damped(), theta, theta <= -5.0)
    assert (metrics.settled_at, metrics.theta_swing, metrics.at_limit) == (0.0, (0.0,), 1.0)
    part = rig_metrics(T, damped(), approach(), np.arange(T.size) < 5000)
    assert part.at_limit == 0.25
    assert rig_metrics(T, damped(), approach()).at_limit is None


def test_no_window_spans_a_pause_or_a_hole():
    x = damped(before=1.0, after=1.0)
    x[T > 100.0] += 50.0  # somebody moved the sensor, while nobody recorded
    kept = (T < 90.0) | (T > 150.0)
    x[16_000] = np.nan
    metrics = rig_metrics(T[kept], x[kept], None)
    assert metrics.after == pytest.approx((1.0, 2.0), rel=0.02)


def test_where_no_window_is_whole_the_longest_segment_counts():
    x = damped(before=1.0, after=1.0)
    kept = np.arange(T.size) % 300 < 290  # no 3 s without a gap
    metrics = rig_metrics(T[kept], x[kept], None)
    assert metrics.before == pytest.approx((1.0, 2.0), rel=0.05)
    assert metrics.after == pytest.approx((1.0, 2.0), rel=0.05)


def test_what_is_too_short_is_refused():
    with pytest.raises(ValueError, match="10 states are too few"):
        rig_metrics(T[:10], damped()[:10], None)


def test_json_has_no_number_that_is_none():
    x = np.zeros((T.size, 2))
    x[:, 1] = np.nan
    actual = rig_metrics(T, x, None).as_dict(("still", "broken"))
    assert actual["amplitude"]["channels"]["still"]["reduction"] is None
    assert actual["amplitude"]["channels"]["broken"]["after"] is None
    assert actual["theta"]["settled"] is None
