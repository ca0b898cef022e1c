"""The adaptive law on static maps whose optimum is known, and what it makes of other input."""

import math

import numpy as np
import pytest

from koop_core.config.parameter import ConfigError
from koop_core.stream.arrival import Arrival
from relay_esc import elementary, relay, swing
from relay_esc.config import EscConfig

DT = 0.1
LAG = 3.0  # time constant of the detector behind the map [s]


def config(**values):
    options = {"law": "adaptive", "step_size": DT / 15.0, "dwell": 10.0, "tau_f": 3.0}
    return EscConfig(**{**options, **values})


def answer(esc, state, r, arrival=Arrival.NEXT, *, switched=False, settling=False, hold=False):
    return relay.answer(esc.params(DT), state, int(arrival), switched, settling, r, hold)


def seek(esc, seconds, optimum, noise=0.1, scale=1.0, sign=1.0, ripple=0.0, seed=1):
    """Let the law seek on ln r = sign ln(1 + 4 (theta - optimum(t))^2) with noise, behind a lag.

    Returns
    -------
    theta, factor : ndarray, shape (M,)
    """
    steps = round(seconds / DT)
    disturbance = np.random.default_rng(seed).normal(0.0, noise, steps)
    p, state, level = esc.params(DT), esc.initial(), 1.0
    theta, factor = np.empty(steps), np.empty(steps)
    for k in range(steps):
        error = theta[k - 1] - optimum(k * DT) if k else 0.0
        waves = ripple * math.sin(2.0 * math.pi * k * DT / 20.0)
        observed = (1.0 + 4.0 * error**2) * math.exp(disturbance[k] + waves)
        level += DT / LAG * (observed - level)
        r = scale * level**sign
        arrival = int(Arrival.NEXT if k else Arrival.RESTART)
        state, _, _ = relay.answer(p, state, arrival, False, False, r, False)
        theta[k], factor[k] = state.output, state.swing.factor
    return theta, factor


def still(t):
    return -3.0


def jumping(t):
    return -3.0 + 2.0 * (t // 500.0 % 2.0)


@pytest.mark.parametrize("noise", [0.0, 0.2, 0.7])
def test_it_arrives_and_swings_less_than_a_third_of_the_relay(noise):
    theta, factor = seek(config(), 1500.0, still, noise)
    fixed, _ = seek(config(step_ratio=1.0), 1500.0, still, noise)
    tail = slice(10_000, None)
    assert abs(theta[tail].mean() + 3.0) < 0.15
    assert np.ptp(theta[tail]) < np.ptp(fixed[tail]) / 3.0
    assert factor[-1] < 0.5
    assert (factor[:600] == 1.0).all()  # on the way, a minute and more, at full step


def test_the_swing_stays_as_wide_as_it_must_be_to_see_the_optimum_through_the_noise():
    narrow, wide = (
        np.median(seek(config(step_ratio=0.001), 3000.0, still, noise)[1][15_000:])
        for noise in (0.2, 5.0)
    )
    assert narrow < 0.01 < 0.9 < wide


@pytest.mark.parametrize("noise", [0.05, 0.5])
def test_it_opens_its_swing_again_when_the_optimum_has_moved(noise):
    theta, factor = seek(config(), 2500.0, jumping, noise)
    narrow = 0
    for begin in (500.0, 1000.0, 1500.0, 2000.0):
        before, after = round(begin / DT), round((begin + 150.0) / DT)
        near = np.abs(theta[before + 50 : after] - jumping(begin)) < 0.3
        assert near.any(), begin
        narrow += factor[before - 1] < 0.5
        assert factor[before:after].max() == 1.0
    assert narrow >= 3  # a long leg may have opened it just before


@pytest.mark.parametrize(("rise", "widened"), [(0.0, False), (0.001, True), (0.02, True)])
def test_a_level_that_creeps_up_by_less_than_its_noise_widens_the_swing_once_it_has_risen(
    rise, widened
):
    noise, known = np.random.default_rng(1).normal(0.0, 0.02, 1000), swing.OPEN
    for leg in range(1000):
        level = rise * max(leg - 100, 0) + noise[leg]
        known = known._replace(lowest=level, level=level + 0.1, begin=level + 0.1)
        known = swing.turn(known, 1.0, 0.02 * (leg % 2), 0.1, True)
        if leg == 100:
            assert known.factor < 0.2
        elif leg > 100 and known.factor == 1.0:
            assert widened
            assert 0.3 < level < 0.7  # log r: an amplitude of about 1.2 times the one before
            return
    assert not widened


def test_a_ripple_of_the_cost_as_long_as_two_legs_does_not_stop_it():
    theta, _ = seek(config(), 1500.0, still, ripple=1.0)
    assert np.abs(theta[10_000:] + 3.0).mean() < 0.5


@pytest.mark.parametrize("law", ["relay", "adaptive"])
@pytest.mark.parametrize(("second", "turns"), [(30.0, False), (300.0, True)])
def test_a_wide_leg_turns_at_a_burst_only_if_it_is_large_beside_the_one_before(law, second, turns):
    esc = config(law=law)
    p, state, r = esc.params(DT), esc.initial(), 1.0
    for k in range(130):  # of the first burst a fortieth is left when the second comes
        r = r * math.exp(-DT / LAG) + {10: 1000.0, 120: second}.get(k, 0.0)
        arrival = int(Arrival.NEXT if k else Arrival.RESTART)
        state, _, _ = relay.answer(p, state, arrival, False, False, r, False)
    assert (state.epsilon == -1) == turns


@pytest.mark.parametrize("scale", [1e-20, 0.37, 1e20])
def test_theta_does_not_know_the_unit_of_the_cost(scale):
    one, factor = seek(config(), 800.0, jumping)
    other, other_factor = seek(config(), 800.0, jumping, scale=scale)
    # the logarithm of another scale rounds otherwise; no flip comes at another sample for that
    np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(other_factor, factor)
    assert factor.min() < 0.5


def test_maximising_is_minimising_the_inverse():
    low, _ = seek(config(), 800.0, jumping)
    high, _ = seek(config(objective="maximise"), 800.0, jumping, sign=-1.0)
    np.testing.assert_allclose(high, low, rtol=0.0, atol=1e-12)


def test_a_rig_that_stood_still_is_maximised_again_at_once():
    """Failed before: its cost had died away, and theta rested for 700 times tau_f."""
    esc = config(objective="maximise")
    p, state, theta, rng = esc.params(DT), esc.initial(), [], np.random.default_rng(0)
    for k in range(9000):
        stands, error = 3000 <= k < 5400, state.output + 3.0
        noise = math.exp(0.05 * rng.normal())
        r = 10.0 ** -(0.125 * (k - 3000)) if stands else noise / (1.0 + 4.0 * error**2)
        state, _, _ = relay.answer(p, state, int(Arrival.NEXT), False, False, r, False)
        theta.append(state.output)
    assert np.abs(np.array(theta[7500:]) + 3.0).mean() < 0.3


def arrived(esc=None):
    """Return a state that has arrived, with a narrow swing."""
    esc = esc or config()
    p, state, rng = esc.params(DT), esc.initial(), np.random.default_rng(3)
    for k in range(9000):
        r = (1.0 + 4.0 * (state.output + 3.0) ** 2) * math.exp(0.05 * rng.normal())
        arrival = int(Arrival.NEXT if k else Arrival.RESTART)
        state, _, _ = relay.answer(p, state, arrival, False, False, r, False)
    assert state.swing.factor < 0.3
    return state


def test_noise_alone_does_not_carry_a_narrow_swing_away_from_where_it_arrived():
    esc, begin, away = config(), arrived(), []
    p = esc.params(DT)
    for seed in range(4):
        state, level, rng = begin, 0.0, np.random.default_rng(seed)
        for noise in rng.normal(0.0, 0.1, 20_000):
            level += DT / LAG * (noise - level)  # a cost that does not know theta
            state, _, _ = relay.answer(p, state, 0, False, False, math.exp(level), False)
            away.append(abs(state.output - begin.output))
    assert np.mean(away) < 0.03  # 0.05 with steps that are as large to both sides


def test_an_unusable_cost_or_a_hold_keeps_theta_and_all_that_was_learned():
    esc, state = config(), arrived()
    for r, asked in ((math.nan, False), (math.inf, False), (0.0, False), (1.0, True)):
        held, holding, _ = answer(esc, state, r, hold=asked)
        assert holding
        assert held == state._replace(primed=False)
    after, holding, _ = answer(esc, held, 1e9)  # a jump while blind is not a rise
    assert not holding
    assert after.cost_rise_filtered == state.cost_rise_filtered
    assert after.output == state.output


def test_after_a_silence_the_leg_begins_again_and_the_level_is_still_known():
    esc, state = config(), arrived()
    after, holding, _ = answer(esc, state, 5.0, Arrival.RESUME)
    assert not holding
    assert (after.since_flip, after.cost_rise_filtered) == (0, 0.0)
    kept = ("factor", "reference", "noise", "dip", "legs")
    assert [getattr(after.swing, n) for n in kept] == [getattr(state.swing, n) for n in kept]
    assert after.swing.level == after.swing.lowest == pytest.approx(math.log(5.0))


@pytest.mark.parametrize("how", [{"arrival": Arrival.RESTART}, {"switched": True}])
def test_another_run_or_another_cost_opens_the_swing_and_forgets_the_level(how):
    after, _, _ = answer(config(), arrived(), 5.0, **how)
    assert after.swing.factor == 1.0
    assert after.swing.legs == 0
    assert after.output == arrived().output


def test_a_controller_that_joins_holds_theta_and_learns_the_level_meanwhile():
    esc, state = config(), arrived()
    state, holding, _ = answer(esc, state, 5.0, Arrival.JOIN)
    held = state.output
    for _ in range(99):  # 10 s: the longer of dwell time and tau_f
        assert holding
        assert (state.output, state.swing.legs) == (held, 0)
        state, holding, _ = answer(esc, state, 5.0)
    state, holding, _ = answer(esc, state, 5.0)
    assert not holding
    assert state.output != held
    assert state.swing.lowest == pytest.approx(math.log(5.0))


def test_a_controller_goes_on_where_an_earlier_one_was():
    before = arrived()
    esc = config(begin=relay.memory(before))
    state, away, rng = esc.initial(), [], np.random.default_rng(5)
    assert state.output == before.output
    for k in range(3000):
        r = (1.0 + 4.0 * (state.output + 3.0) ** 2) * math.exp(0.05 * rng.normal())
        state, holding, _ = answer(esc, state, r, Arrival.NEXT if k else Arrival.JOIN)
        assert holding == (k < 100)  # 10 s: as one that joins a run
        if holding:
            assert relay.memory(state) == relay.memory(before)
        away.append(abs(state.output + 3.0))
    assert max(away) < 0.3  # 0.25 without an end; 0.88 from the same theta with an open swing
    for wrong in ((1.0,), (*esc.begin, 0.0), (-3.0, 0.0, *esc.begin[2:])):
        with pytest.raises(ConfigError, match="begin: is not what a controller goes on from"):
            config(begin=wrong)


def test_a_reset_opens_the_swing_at_the_initial_theta():
    esc, state = config(rate_limit=0.05), arrived()
    begun = relay.reset(state, esc.initial())
    assert (begun.u, begun.output, begun.swing) == (2.0, state.output, swing.OPEN)
    after, _, _ = answer(esc, begun, 1.0)
    assert after.output == pytest.approx(state.output + 0.05 * DT)


def test_confidence_is_lost_with_the_level():
    esc, state = config(), arrived()
    _, noise, before = relay.insight(esc.params(DT), state)
    assert 0.0 < noise < 0.5
    assert before > 0.5
    p = esc.params(DT)
    for _ in range(1000):
        state, _, _ = answer(esc, state, 1e6 * (1.1 + math.sin(state.since_flip)))
    assert relay.insight(p, state)[2] == 0.0
    unknown = relay.insight(EscConfig().params(DT), EscConfig().initial())[1:]
    assert all(math.isnan(v) for v in unknown)


def test_the_gradient_is_that_of_the_map():
    esc = config(step_ratio=1.0)
    p, state = esc.params(DT), esc.initial()
    for k in range(300):  # far from the optimum, without a lag: ln r = 0.7 theta
        arrival = int(Arrival.NEXT if k else Arrival.RESTART)
        state, _, _ = relay.answer(p, state, arrival, False, False, math.exp(0.7 * state.u), False)
    assert relay.insight(p, state)[0] == pytest.approx(0.7, rel=1e-3)


def test_logarithm_and_exponential_are_the_usual_ones():
    x = np.exp(np.random.default_rng(4).uniform(-700.0, 700.0, 5000))
    ours = np.array([elementary.log(value) for value in x])
    np.testing.assert_allclose(ours, np.log(x), rtol=1e-15, atol=5e-16)
    y = np.random.default_rng(5).uniform(-40.0, 40.0, 5000)
    ours = np.array([elementary.exp(value) for value in y])
    np.testing.assert_allclose(ours, np.exp(y), rtol=1e-15)
    assert elementary.log(1.0) == 0.0
    assert elementary.exp(0.0) == 1.0


# -- theta_scale: log ---------------------------------------------------------------------------


@pytest.mark.parametrize("law", ["relay", "adaptive"])
def test_on_a_log_scale_the_law_seeks_in_the_logarithm_of_theta(law):
    scale = {"theta_min": 1e-3, "theta_max": 1e4, "theta_initial": 0.5, "rate_limit": 0.05}
    linear = {
        "theta_min": math.log(1e-3), "theta_max": math.log(1e4), "theta_initial": math.log(0.5),
        "rate_limit": 0.05,
    }  # fmt: skip
    one, other = config(law=law, theta_scale="log", **scale), config(law=law, **linear)
    states = [one.initial(), other.initial()]
    assert states[0].output == 0.5
    for r in np.exp(np.random.default_rng(6).normal(0.0, 0.1, 3000).cumsum() * 0.2):
        states = [answer(esc, s, r)[0] for esc, s in zip((one, other), states, strict=True)]
        assert math.log(states[0].output) == pytest.approx(states[1].output, abs=1e-12)


def test_on_a_log_scale_the_limits_are_met_exactly():
    options = {"theta_min": 0.1, "theta_max": 0.3}
    for first, limit in ((0.29, 0.1), (0.11, 0.3)):
        esc = config(law="relay", theta_scale="log", theta_initial=first, **options)
        state = esc.initial()
        for k in range(200):
            state, _, saturated = answer(esc, state, 1.0 - 1e-3 * k)
            assert 0.1 <= state.output <= 0.3
        assert (state.output, saturated) == (limit, True)


def test_a_log_scale_needs_limits_above_0():
    with pytest.raises(ConfigError, match=r"theta_min = -5: must be above 0 with theta_scale log"):
        EscConfig(theta_scale="log")


# -- limits that open ----------------------------------------------------------------------------


def leaves(t):
    return -3.0 if t < 600.0 or t > 2000.0 else 1.0


@pytest.mark.parametrize("noise", [0.0, 0.2])
def test_theta_follows_an_optimum_that_leaves_its_limits_and_comes_back(noise):
    limits = {"theta_min": -4.0, "theta_max": -2.0, "theta_initial": -3.0}
    esc = config(widest=(-5.0, 5.0), **limits)
    theta, _ = seek(esc, 3400.0, leaves, noise)
    within = slice(0, 6000)
    assert (theta[within].min(), theta[within].max()) >= (-4.0, -4.0)
    assert theta[within].max() <= -2.0
    assert abs(theta[16_000:20_000].mean() - 1.0) < 0.3
    assert np.abs(np.diff(theta)).max() <= esc.step_size * (1.0 + 1e-9)
    assert np.ptp(theta[-6000:]) <= 2.0
    kept, _ = seek(config(**limits), 2000.0, leaves, noise)
    assert kept.max() <= -2.0  # the test can fail
    narrow, _ = seek(config(widest=(-5.0, -1.0), **limits), 2000.0, leaves, noise)
    assert narrow.max() == -1.0


def test_open_limits_close_with_a_leg_at_home_within_them():
    esc = config(theta_min=-4.0, theta_max=-2.0, theta_initial=-3.0, widest=(-5.0, 5.0))
    state = arrived(esc)
    state = state._replace(swing=state.swing._replace(below=0.5, beyond=2.0))
    legs, rng = state.swing.legs, np.random.default_rng(4)
    while state.swing.legs < legs + 4:
        r = (1.0 + 4.0 * (state.output + 3.0) ** 2) * math.exp(0.05 * rng.normal())
        state, _, _ = answer(esc, state, r)
    assert (state.swing.below, state.swing.beyond) == (0.0, 0.0)


def test_on_a_log_scale_limits_open_no_further_than_the_widest():
    esc = config(
        theta_scale="log", theta_min=0.1, theta_max=0.3, theta_initial=0.2, widest=(0.03, 0.7)
    )
    p, state, seen = esc.params(DT), esc.initial(), []
    for k in range(20_000):  # first the best is inside
        r = 1.0 + abs(math.log(state.output / 0.2)) if k < 5000 else 1.0 / state.output
        arrival = int(Arrival.NEXT if k else Arrival.RESTART)
        state, _, saturated = relay.answer(p, state, arrival, False, False, r, False)
        seen.append(state.output)
    assert (max(seen[:5000]) <= 0.3, max(seen), saturated) == (True, 0.7, True)
    assert (state.swing.below, state.swing.beyond) == (0.0, pytest.approx(math.log(0.7 / 0.3)))


@pytest.mark.parametrize("widest", [(0.0,), (-2.0, 3.0), (-6.0, 1.0), (5.0, -5.0)])
def test_widest_limits_that_are_not_around_the_limits_are_refused(widest):
    with pytest.raises(ConfigError, match=r"widest = .*: must be \[least, largest\] theta, around"):
        config(theta_min=-5.0, theta_max=2.0, widest=widest)
