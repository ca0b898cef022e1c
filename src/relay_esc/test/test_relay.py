"""The relay against sequences that can be worked out by hand."""

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from koop_core.config.parameter import ConfigError
from koop_core.stream.arrival import Arrival
from relay_esc import relay
from relay_esc.config import EscConfig

DT = 0.005  # [s]


def run(config: EscConfig, costs, state=None, dt=DT):
    state = state or config.initial()
    states = []
    for r in costs:
        state = relay.step(config.params(dt), state, float(r))
        states.append(state)
    return states


def test_a_hand_computed_sequence():
    """dt = 1, tau_f = 1 / ln 2 (alpha = 1/2), k = 1, dwell 2 s, theta from 0, epsilon from +1.

    r       cost_rise_filtered                                  since flip   epsilon  theta
    4       0 (primes)                          0            +1       0
    6       (6-4)/2 = 1 > 0, dwell 1 < 2        1            +1       -1
    6       1/2 + 0 = 0.5 > 0, dwell 2: flip    2 -> 0       -1       0
    4       0.25 + (4-6)/2 = -0.75              1            -1       1
    4       -0.375                              2            -1       2
    8       -0.1875 + 2 = 1.8125, dwell 3: flip 3 -> 0       +1       1
    8       0.90625, dwell 1 < 2                1            +1       0
    8       0.453125, dwell 2: flip             2 -> 0       -1       1
    """
    config = EscConfig(tau_f=1.0 / math.log(2.0), step_size=1.0, dwell=2.0, theta_initial=0.0)
    states = run(config, [4, 6, 6, 4, 4, 8, 8, 8], dt=1.0)
    assert [s.u for s in states] == [0, -1, 0, 1, 2, 1, 0, 1]
    assert [s.epsilon for s in states] == [1, 1, -1, -1, -1, 1, 1, -1]
    np.testing.assert_allclose(
        [s.cost_rise_filtered for s in states],
        [0, 1, 0.5, -0.75, -0.375, 1.8125, 0.90625, 0.453125],
        atol=1e-15,
    )


def test_the_filter_is_scipy_s():
    config = EscConfig()
    r = np.random.default_rng(1).normal(size=500).cumsum()
    alpha = config.params(DT).alpha
    expected = lfilter([1 - alpha, -(1 - alpha)], [1, -alpha], r - r[0])
    np.testing.assert_allclose(
        [s.cost_rise_filtered for s in run(config, r)], expected, rtol=1e-9, atol=1e-12
    )


def test_the_paper_s_ramp_crosses_five_units_in_75_seconds_when_the_cost_falls():
    config = EscConfig()
    states = run(config, np.linspace(1.0, 0.0, 15_001))
    assert states[-1].u == pytest.approx(2.0 - 5.0, abs=1e-9)
    assert all(s.epsilon == 1 for s in states)


def test_the_relay_keeps_its_direction_until_the_dwell_time_has_passed():
    config = EscConfig()
    states = run(config, np.arange(4000.0))  # always rising: it would flip at every sample
    flips = np.flatnonzero(np.diff([s.epsilon for s in states])) + 1
    assert flips.tolist() == [3000]  # 15 s / 5 ms samples after the first
    assert relay.dwell_samples(15.0, 0.005) == 3000


def test_theta_stops_at_its_limits():
    config = EscConfig(theta_min=1.99, theta_max=2.005)
    states = run(config, np.linspace(1.0, 0.0, 100))
    assert states[-1].u == 1.99
    assert answer(config, states[-1], 0.0)[2]
    assert not answer(config, states[0], 1.0)[2]


def test_maximising_is_minimising_the_negated_cost():
    costs = np.random.default_rng(2).normal(size=9000).cumsum()
    low = run(EscConfig(objective="minimise"), costs)
    high = run(EscConfig(objective="maximise"), -costs)
    assert [s.u for s in low] == [s.u for s in high]
    assert len({s.epsilon for s in low}) == 2


def test_a_jump_of_the_cost_during_a_hold_causes_no_flip():
    config = EscConfig(dwell=0.0)
    held = relay.hold(run(config, np.linspace(1.0, 0.9, 50))[-1])
    after = run(config, [1e6, 1e6 - 1.0, 1e6 - 2.0], held)
    assert [s.epsilon for s in after] == [1, 1, 1]
    assert after[0].u == held.u


def test_the_compiled_kernel_is_the_python_function():
    config = EscConfig()
    state = relay.step(config.params(DT), config.initial(), 3.0)
    assert relay.step(config.params(DT), state, 4.0) == relay.step.py_func(
        config.params(DT), state, 4.0
    )


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"theta_min": 5.0, "theta_max": -5.0}, "theta_min = 5 must be below theta_max = -5"),
        ({"theta_initial": 9.0}, "theta_initial = 9 must lie within"),
        ({"tau_f": 0.0}, "tau_f = 0: must be 0.001 to 1e\\+08 s"),
        ({"objective": "minimize"}, "must be one of minimise, maximise"),
    ],
)
def test_a_bad_value_is_refused_with_the_reason(values, message):
    with pytest.raises(ConfigError, match=message):
        EscConfig(**values)


def answer(
    config, state, r, arrival=Arrival.NEXT, *, switched=False, settling=False, hold=False, dt=DT
):
    return relay.answer(config.params(dt), state, int(arrival), switched, settling, r, hold)


def same(state, **changes):
    u = changes.get("u", state.u)
    return state._replace(commanded=u, output=u, **changes)


def test_an_answer_is_held_or_the_next_step_or_the_first():
    config = EscConfig(dwell=0.0)
    state = config.initial()
    for r in (3.0, 2.5, 2.2):
        state, holding, _ = answer(config, state, r)
        assert not holding
    moved = same(relay.step(config.params(DT), state, 9.0))
    assert answer(config, state, 9.0)[:2] == (same(moved), False)
    assert answer(config, state, 9.0, hold=True)[:2] == (relay.hold(state), True)
    assert answer(config, state, math.nan)[:2] == (relay.hold(state), True)
    first = same(state, cost_rise_filtered=0.0, x_previous=9.0, since_flip=0)
    for how in ({"arrival": Arrival.RESUME}, {"arrival": Arrival.RESTART}, {"switched": True}):
        assert answer(config, state, 9.0, **how)[:2] == (first, False)


def test_after_a_reset_filter_the_dwell_time_guards_what_has_not_settled():
    config = EscConfig(dwell=0.05)  # 10 samples
    state = run(config, np.linspace(1.0, 0.5, 50))[-1]  # falling, the dwell time is long past
    state, _, _ = answer(config, same(state), 7.0, Arrival.RESUME)
    for _ in range(9):  # a rise that would turn the relay at once
        state, holding, _ = answer(config, state, state.x_previous + 1e-6)
        assert not holding
        assert state.epsilon == 1
    state, _, _ = answer(config, state, state.x_previous + 1e-6)
    assert state.epsilon == -1


def test_a_controller_that_joins_holds_theta_while_its_filter_settles_and_then_dwells():
    config = EscConfig(dwell=2.0, tau_f=3.0)
    r = np.random.default_rng(7).normal(size=60).cumsum() + 0.2 * np.arange(60)
    state, held = config.initial(), []
    for k in range(60):
        arrival = Arrival.NEXT if k else Arrival.JOIN
        # neither a cost that is unusable nor a hold of the user's begins the wait again
        cost = math.nan if k == 5 else r[k]
        state, holding, _ = answer(config, state, cost, arrival, hold=k == 9, dt=0.1)
        held.append(holding)
        if k == 4:
            b = math.exp(-0.1 / 3.0)
            expected = lfilter([1 - b, b - 1], [1, -b], r[:5] - r[0])[-1]
            assert state.cost_rise_filtered == pytest.approx(expected, rel=1e-9)
        if holding:
            assert (state.output, state.epsilon) == (2.0, 1)
        if not holding and k < 49:
            assert state.epsilon == 1
    assert held == [True] * 30 + [False] * 30  # 3 s, the longer of both times
    assert state.epsilon == -1  # the cost rose all the time, and 2 s of dwell are over


def test_while_the_cost_settles_the_filter_waits_and_then_the_dwell_time_begins():
    config = EscConfig(dwell=0.05)
    before = same(run(config, np.linspace(1.0, 0.5, 50))[-1])
    state, holding, _ = answer(config, before, math.nan, Arrival.RESUME, settling=True)
    for _ in range(100):
        state, holding, _ = answer(config, state, math.nan, settling=True)
        assert holding
    assert state.cost_rise_filtered == before.cost_rise_filtered < 0.0
    assert (state.u, state.since_flip) == (before.u, 0)
    state, holding, _ = answer(config, state, 1e9)  # no rise: nobody knows the cost before it
    assert not holding
    assert (state.cost_rise_filtered, state.u) == (before.cost_rise_filtered, before.u)


def test_a_held_filter_goes_on_from_where_it_was():
    config = EscConfig(dwell=0.0)
    before = same(run(config, np.linspace(1.0, 0.5, 50))[-1])
    for r, asked in ((math.nan, False), (math.inf, False), (0.4, True)):
        held, holding, _ = answer(config, before, r, hold=asked)
        assert holding
        assert held == before._replace(primed=False)
    after, _, _ = answer(config, held, 1e9)  # a jump while blind
    assert after.epsilon == before.epsilon
    assert after.cost_rise_filtered == before.cost_rise_filtered


def test_what_is_given_out_gets_to_a_jump_at_its_limited_rate():
    config = EscConfig(rate_limit=0.02)  # 1e-4 a sample
    away = same(run(config, np.linspace(1.0, 0.0, 201))[-1])
    state = relay.reset(away, config.initial())
    for k in range(1, 4):
        state, _, _ = answer(config, state, 1.0, hold=True)
        assert state.output == pytest.approx(away.output + k * 1e-4)


@pytest.mark.parametrize("law", ["relay", "adaptive"])
def test_from_beyond_its_limits_theta_goes_there_and_the_relay_waits(law):
    common = {"law": law, "rate_limit": 0.02, "theta_max": 1.9}
    narrowed, begins = EscConfig(**common, theta_initial=1.0), EscConfig(**common)
    for state in (EscConfig().initial(), begins.initial()):
        for k in range(1, 1000):
            state, holding, saturated = answer(narrowed, state, 2000.0 - k)
            assert state.output == pytest.approx(2.0 - k * 1e-4)
            assert holding
            assert saturated
        for k in range(200):
            state, holding, _ = answer(narrowed, state, 1000.0 - k)
        assert not holding
        assert state.output <= 1.9


def test_theta_changes_no_faster_than_its_rate_limit():
    assert relay.slew(1.0, 1.5, 0.1) == 1.1
    assert relay.slew(1.0, -9.0, 0.25) == 0.75
    assert relay.slew(1.0, 0.9, math.inf) == 0.9
    config = EscConfig(rate_limit=0.02)  # the relay alone would move by 0.0667 a second
    states = run(config, np.linspace(1.0, 0.0, 201))
    assert states[-1].u == pytest.approx(2.0 - 0.02)


def test_a_dwell_time_of_n_samples_is_n_samples():
    # 0.035 / 0.005 is 7.000000000000001 in floating point
    assert relay.dwell_samples(0.035, 0.005) == 7
    assert relay.dwell_samples(0.036, 0.005) == 8
    assert relay.dwell_samples(0.0, 0.005) == 0


def test_holding_keeps_the_dwell_time_that_has_passed():
    config = EscConfig(dwell=3.0, step_size=1.0)
    (*_, state) = run(config, [1.0, 2.0], dt=1.0)  # one sample of the dwell time, the cost rises
    state = relay.hold(relay.hold(state))
    (_, waiting, flipped) = run(config, [3.0, 4.0, 5.0], state, 1.0)
    assert (waiting.epsilon, flipped.epsilon) == (1, -1)
