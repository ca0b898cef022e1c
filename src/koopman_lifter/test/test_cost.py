"""The cost and its detector against SciPy's filters and the paper's formulas."""

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from koop_core.stream.arrival import Arrival
from koopman_lifter import cost
from koopman_lifter.config import LifterConfig, shipped_model
from koopman_lifter.model import load


def detector(config, samples):
    state, out = cost.initial(), []
    for y in samples:
        r, state = cost.detect(config.detector_params(), state, y)
        out.append(r)
    return np.array(out)


def test_the_detector_is_two_scipy_filters_and_a_square():
    config = LifterConfig()
    y = np.random.default_rng(0).normal(size=2000).cumsum()
    a_hp, a_lp = math.exp(-config.omega_h * config.dt), math.exp(-config.omega_l * config.dt)
    high = lfilter([1 - a_hp, -(1 - a_hp)], [1, -a_hp], y - y[0])
    expected = lfilter([1 - a_lp], [1, -a_lp], high**2)
    np.testing.assert_allclose(detector(config, y), expected, rtol=1e-9, atol=1e-15)


def test_a_constant_energy_costs_nothing_from_the_first_sample_on():
    assert (detector(LifterConfig(), np.full(100, 1e9)) == 0.0).all()


def test_a_sine_settles_at_the_mean_square_of_the_high_passed_sine():
    config = LifterConfig(omega_h=20.0, omega_l=0.1)
    amplitude, omega, dt = 3.0, 10.0, config.dt
    t = np.arange(round(200.0 / dt)) * dt
    r = detector(config, amplitude * np.sin(omega * t))
    z = np.exp(1j * omega * dt)
    a = math.exp(-config.omega_h * dt)
    gain = abs((1 - a) * (1 - 1 / z) / (1 - a / z))
    # ripple at 2 omega passes the low-pass by omega_l / (2 omega) = 0.5 %
    assert r[-1] == pytest.approx((amplitude * gain) ** 2 / 2, rel=0.01)


def test_raw_and_lifted_energy_are_the_paper_s_formulas():
    model = load(shipped_model())
    work = cost.workspace(model.lifting())
    first = int(Arrival.RESTART), 0
    for x in np.random.default_rng(1).normal(size=(10, 2)) * 15:
        raw = cost.energy(cost.RAW, model.lifting(), *first, x, work)[0]
        assert raw == pytest.approx(np.linalg.norm(x) / np.sqrt(2), rel=1e-14)
        modal = np.linalg.pinv(model.V_dom) @ model.observables.lift(x)
        lifted = cost.energy(cost.LIFTED, model.lifting(), *first, x, work)[0]
        assert lifted == pytest.approx(np.linalg.norm(modal) ** 2, rel=1e-6)


def answers(states, arrivals=None, state=None, **options):
    """Return r and settling of every state, and the detector after them, for the lifted cost."""
    model = load(shipped_model())
    work = cost.workspace(model.lifting())
    params, state = LifterConfig(**options).detector_params(), state or cost.initial()
    arrivals = arrivals or [Arrival.RESTART, *[Arrival.NEXT] * (len(states) - 1)]
    actual = []
    for k, (x, arrival) in enumerate(zip(states, arrivals, strict=True)):
        r, _, settling, state = cost.answer(
            cost.LIFTED, model.lifting(), params, state, int(arrival), k, np.asarray(x), work
        )
        actual.append((r, settling))
    r, settling = np.array(actual).T
    return r, settling.astype(bool), state


def test_an_unusable_state_costs_nan_and_leaves_the_filters_alone():
    x = 10.0 * np.random.default_rng(3).standard_normal((100, 2))
    _, _, before = answers(x)
    # of the last one the energy is finite, its square is not
    for bad in ([np.nan, 0.0], [np.inf, 0.0], [1e200, 0.0], [1e30, 0.0]):
        r, settling, after = answers([bad], [Arrival.NEXT], before)
        assert math.isnan(r[0])
        assert not settling[0]
        assert after == cost.resume(before)


def test_a_spike_beyond_the_limit_is_unusable_and_leaves_no_trace():
    model = load(shipped_model())
    work, first = cost.workspace(model.lifting()), (int(Arrival.RESTART), 0)
    x = 10.0 * np.random.default_rng(0).standard_normal((4000, 2))
    spiked = np.insert(x, 2000, [300.0, 0.0], axis=0)
    limit = 10.0 * max(cost.energy(cost.LIFTED, model.lifting(), *first, row, work)[0] for row in x)
    free, limited = answers(spiked)[0], answers(spiked, y_out_max=limit)[0]
    assert np.isnan(limited[2000])
    # as if the spike had not been, but for the difference to it
    resumed = [Arrival.RESTART, *[Arrival.NEXT] * 1999, Arrival.RESUME, *[Arrival.NEXT] * 1999]
    assert np.array_equal(np.delete(limited, 2000), answers(x, resumed)[0])
    assert free[2001:].min() > 100.0 * limited[:2000].max()  # else r only falls, for seconds


def test_a_detector_that_joins_a_run_has_the_mean_of_what_it_saw_for_its_first_cost():
    config = LifterConfig()
    x = 10.0 * np.random.default_rng(4).standard_normal((6000, 2))
    r, settling, _ = answers(x, [Arrival.JOIN, *[Arrival.NEXT] * 5999])
    n = math.ceil(3.0 * (1.0 / 20.0 + 1.0 / 0.3) / config.dt)  # three times both time constants
    assert np.array_equal(np.isnan(r), settling)
    assert settling.sum() == n
    model = load(shipped_model())
    y = np.sum((model.projector @ model.observables.lift(x.T)) ** 2, axis=0)
    a_hp, a_lp = math.exp(-config.omega_h * config.dt), math.exp(-config.omega_l * config.dt)
    squares = lfilter([1 - a_hp, -(1 - a_hp)], [1, -a_hp], y - y[0])[1:] ** 2
    weights = a_lp ** np.arange(n)[::-1]
    assert r[n] == pytest.approx(np.average(squares[:n], weights=weights), rel=1e-9)
    expected, _ = lfilter([1 - a_lp], [1, -a_lp], squares[n:], zi=[a_lp * r[n]])
    np.testing.assert_allclose(r[n + 1 :], expected, rtol=1e-9)


def test_settling_goes_on_over_a_silence_and_an_unusable_state():
    x = 10.0 * np.random.default_rng(5).standard_normal((3000, 2))
    x[700] = np.nan
    arrivals = [Arrival.JOIN, *[Arrival.NEXT] * 2999]
    arrivals[400] = Arrival.RESUME
    settling = answers(x, arrivals)[1]
    # neither they nor the state after the unusable one is a sample of the filters
    assert settling.sum() == LifterConfig().detector_params().settling + 3


def test_a_run_that_begins_is_answered_from_its_first_state_on():
    x = 10.0 * np.random.default_rng(6).standard_normal((50, 2))
    _, _, before = answers(x)
    again = answers(x, [Arrival.RESTART, *[Arrival.NEXT] * 49], before)[0]
    assert np.array_equal(again, answers(x)[0])
    assert again[0] == 0.0


def test_after_a_silence_the_cost_goes_on_from_where_it_was():
    params = cost.detector_params(20.0, 0.3, 0.005)
    state = cost.initial()
    for k in range(4000):
        r, state = cost.detect(params, state, 3.0 * np.sin(0.04 * k))
    jump = 1e6  # what the energy did meanwhile is not an oscillation
    after, state = cost.detect(params, cost.resume(state), jump)
    assert after == r
    for k in range(4000, 8000):
        after, state = cost.detect(params, state, jump + 3.0 * np.sin(0.04 * k))
    assert after == pytest.approx(r, rel=0.1)  # the residue is the cost's own ripple
