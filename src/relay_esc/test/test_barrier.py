"""The barrier keeps a bound that cuts off the optimum; without one nothing changes."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from koop_core.stream.arrival import Arrival
from relay_esc import barrier, relay
from relay_esc.config import EscConfig

DT, LAG = 0.1, 3.0
LAWS = pytest.mark.parametrize("law", ["relay", "adaptive"])


def config(law, **values):
    options = {"step_size": DT / 30.0, "dwell": 10.0, "tau_f": 3.0, "theta_initial": 4.0}
    return EscConfig(**{"law": law, "theta_min": -5.0, "theta_max": 5.0, **options, **values})


def seek(esc, seconds, bound, noise=0.02, seed=1, best=0.0, wander=0.0):
    """Seek the least of 1 + (theta - best)^2 / 4, where 1 - exp(bound(t) - theta) is the margin.

    With a slope below 0 the bound is from above. Both are seen behind a lag; the logarithm of the
    cost wanders, over 5 s. Returns theta and the margin without noise, shape (M,).
    """
    side = -1.0 if esc.margin_slope < 0.0 else 1.0
    steps = round(seconds / DT)
    rng, alpha = np.random.default_rng(seed), math.exp(-DT / 5.0)
    shake = rng.normal(0.0, noise, (steps, 2))
    if wander:
        white = rng.normal(0.0, wander, steps)
        shake[:, 0] += lfilter([math.sqrt(1.0 - alpha**2)], [1.0, -alpha], white)
    p, q = esc.params(DT), esc.barrier(DT)
    state, held = esc.initial(), barrier.UNKNOWN
    r = 1.0 + (esc.theta_initial - best) ** 2 / 4.0
    s = math.exp(side * (bound(0.0) - esc.theta_initial))
    theta, left = np.empty(steps), np.empty(steps)
    for k in range(steps):
        now = state.output
        r += DT / LAG * (1.0 + (now - best) ** 2 / 4.0 - r)
        s += DT / LAG * (math.exp(side * (bound(k * DT) - now)) - s)
        arrival = int(Arrival.NEXT if k else Arrival.RESTART)
        state, held, _, _ = barrier.answer(
            p, q, state, held, arrival, False, False, r * math.exp(shake[k, 0]), False,
            1.0 - s * math.exp(shake[k, 1]),
        )  # fmt: skip
        theta[k], left[k] = state.output, 1.0 - s
    return theta, left


@LAWS
@pytest.mark.parametrize("steeper", [0.5, 1.0, 3.0])  # than the slope that was seen
def test_theta_stays_at_the_bound_that_cuts_off_the_optimum(law, steeper):
    """The optimum is 0, the bound at 1: theta rests beyond it, near it."""
    theta, left = seek(config(law, margin_slope=steeper), 1500.0, lambda t: 1.0)
    late = left[left.size // 3 :]
    assert (late < 0.0).mean() <= 0.01
    assert late.min() > -0.01
    assert 1.0 < theta[-5000:].mean() < 1.25
    free, broken = seek(config(law), 1500.0, lambda t: 1.0)
    assert free[-5000:].mean() < 1.0
    assert (broken[-5000:] < 0.0).mean() > 0.9  # the test can fail


@LAWS
@pytest.mark.parametrize("start", [-1.05, -4.0])
@pytest.mark.parametrize("tau_f", [3.0, 30.0])
@pytest.mark.parametrize("speed", [0.1, 0.3])
def test_theta_does_not_rest_on_its_way_to_the_bound(law, speed, tau_f, start):
    """Failed before: a leg away from the bound and theta stood there for good, 0.4 beside it."""
    esc = config(law, step_size=speed * DT, tau_f=tau_f, theta_initial=start, margin_slope=-1.0)
    theta, left = seek(esc, 1500.0, lambda t: -1.0)
    assert -1.25 < theta[-5000:].mean() < -1.0
    assert (left[left.size // 3 :] < 0.0).mean() <= 0.01


@pytest.mark.parametrize("seed", range(3))
def test_theta_stays_at_the_bound_though_the_cost_wanders(seed):
    """As of a rig that noise drives slowly; a leg that began far inside is not turned by that."""
    esc = config("adaptive", step_size=0.3 * DT, theta_initial=-4.5, margin_slope=-1.0)
    theta, _ = seek(esc, 1500.0, lambda t: -1.0, seed=seed, best=1.0, wander=0.5)
    assert -1.3 < theta[-5000:].mean() < -1.0


@pytest.mark.parametrize("start", [-1.05, -4.0])
def test_an_optimum_beside_the_bound_is_sought_as_any(start):
    esc = config("adaptive", step_size=0.1 * DT, theta_initial=start, margin_slope=-1.0)
    theta, _ = seek(esc, 1500.0, lambda t: -1.0, best=-3.0)
    assert theta[-5000:].mean() == pytest.approx(-3.0, abs=0.3)


@LAWS
def test_theta_goes_back_where_the_bound_moves(law):
    theta, left = seek(
        config(law, margin_slope=1.0),
        3000.0,
        lambda t: 1.0 + min(max(t - 1000.0, 0.0), 1000.0) / 500.0,
    )
    assert (left[-5000:] < 0.0).mean() <= 0.01
    assert 3.0 < theta[-5000:].mean() < 3.2
    assert left[10000:20000].min() > -0.05  # on the way


@LAWS
def test_a_bound_that_is_far_changes_little(law):
    theta, _ = seek(config(law, margin_slope=1.0), 1500.0, lambda t: -8.0)
    free, _ = seek(config(law), 1500.0, lambda t: -8.0)
    np.testing.assert_array_equal(theta, free)


@LAWS
def test_theta_is_held_while_the_margin_is_not_known(law):
    esc = config(law, margin_slope=1.0)
    p, q, state, held = esc.params(DT), esc.barrier(DT), esc.initial(), barrier.UNKNOWN
    for k in range(200):
        arrival = int(Arrival.NEXT if k else Arrival.RESTART)
        margin = math.nan if 100 <= k < 150 else 0.9
        before = state.output
        state, held, holding, _ = barrier.answer(
            p, q, state, held, arrival, False, False, 1.0, False, margin
        )
        assert holding == (100 <= k < 150)
        assert not (holding and state.output != before)


COST = st.one_of(st.floats(1e-3, 1e3), st.sampled_from([math.nan, math.inf, 0.0]))
ARRIVALS = st.sampled_from([Arrival.NEXT] * 6 + [Arrival.RESUME, Arrival.RESTART, Arrival.JOIN])


@LAWS
@settings(deadline=None, max_examples=50)
@given(answers=st.lists(st.tuples(ARRIVALS, st.booleans(), COST, st.booleans()), max_size=60))
def test_without_a_slope_it_is_the_relay_to_the_last_bit(law, answers):
    esc = config(law, dwell=0.3)
    p, q, ours, theirs = esc.params(DT), esc.barrier(DT), esc.initial(), esc.initial()
    held = barrier.UNKNOWN
    for arrival, switched, r, hold in answers:
        ours, held, *flags = barrier.answer(
            p, q, ours, held, int(arrival), switched, False, r, hold, math.nan
        )
        theirs, *expected = relay.answer(p, theirs, int(arrival), switched, False, r, hold)
        assert flags == expected
        assert repr(ours) == repr(theirs)


@LAWS
@settings(deadline=None, max_examples=50)
@given(
    answers=st.lists(st.tuples(ARRIVALS, COST, st.floats(-2.0, 1.0)), max_size=80),
    slope=st.sampled_from([-1e3, -1.0, -1e-3, 1e-3, 1.0, 1e3]),
)
def test_theta_keeps_its_limits_and_its_step_whatever_the_margin_says(law, answers, slope):
    esc = config(law, dwell=0.3, margin_slope=slope, theta_min=3.9, theta_max=4.1)
    p, q, state, held = esc.params(DT), esc.barrier(DT), esc.initial(), barrier.UNKNOWN
    for arrival, r, margin in answers:
        before = state.output
        state, held, _, _ = barrier.answer(
            p, q, state, held, int(arrival), False, False, r, False, margin
        )
        assert 3.9 <= state.output <= 4.1
        assert abs(state.output - before) <= esc.step_size * (1.0 + 1e-9)
