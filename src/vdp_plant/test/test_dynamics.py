"""The plant's kernels against SciPy and against the order that each integrator must have."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from koop_core.config.parameter import ConfigError
from vdp_plant import dynamics
from vdp_plant.config import PlantConfig

THETA = -2.4
START = np.array([5.0, 1.5])
HORIZON = 4.0  # [s] long enough for a full swing, short enough to stay clear of chaos


def reference(config: PlantConfig, theta: float, start: np.ndarray, t: float) -> np.ndarray:
    """Integrate the paper's equations 8 and 9, written out again, with SciPy's DOP853."""

    def field(time, state):
        x, y = state
        eps = config.epsilon0 + config.epsilon0_drift * np.sin(config.drift_frequency * time)
        f = config.forcing_amplitude * np.sin(config.forcing_frequency * time)
        limit = (x - config.x_offset) ** 2 - 1 - (theta - config.theta_star) ** 2
        return [y, -eps * limit * y - config.mu**2 * (x - config.x_offset) + f]

    return solve_ivp(field, (0, t), start, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]


def integrate(config: PlantConfig, theta: float, start: np.ndarray, steps: int) -> np.ndarray:
    (x, y), params = start, config.params()
    for k in range(steps):
        x, y = dynamics.step(params, k, x, y, theta)
    return np.array([x, y])


def test_a_trajectory_agrees_with_scipy():
    config = PlantConfig()
    end = integrate(config, THETA, START, round(HORIZON / config.dt))
    # RK4 at dt = 5 ms: global error about 1e-8 on this smooth arc
    np.testing.assert_allclose(end, reference(config, THETA, START, HORIZON), rtol=1e-6)


def test_halving_the_step_reduces_the_error_by_the_order_of_the_integrator():
    config = PlantConfig()
    exact = reference(config, THETA, START, HORIZON)
    steps = np.array([400, 800, 1600])
    errors = [
        np.linalg.norm(integrate(replace(config, dt=HORIZON / n), THETA, START, n) - exact)
        for n in steps
    ]
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    # the next term of the error expansion is a few per cent at these steps
    np.testing.assert_allclose(slopes, 4, atol=0.15)


def test_the_interference_is_the_paper_s_and_corrupts_both_components():
    config = PlantConfig()
    for k in (0, 1, 777, 499_999):
        t = k * config.dt
        i = 10.5 * np.sin(3.2 * t) + 11.1 * np.sin(7.8 * t)
        np.testing.assert_allclose(
            dynamics.measure(config.params(), k, 1.0, -2.0), [1.0 + i, -2.0 + i], rtol=1e-12
        )


def test_the_amplitude_of_the_limit_cycle_grows_with_the_distance_from_theta_star():
    """Without forcing the cycle's amplitude is about 2 sqrt(1 + (theta - theta*)^2) (Wang 2000)."""
    params = PlantConfig(forcing_amplitude=0.0, epsilon0=0.1, epsilon0_drift=0.0).params()
    for theta in (-3.0, -2.0, -1.0):
        x, y, largest = 7.0, 0.0, 0.0
        for k in range(60_000):
            x, y = dynamics.step(params, k, x, y, theta)
            if k > 50_000:
                largest = max(largest, abs(x - 6.0))
        # averaging holds to first order in epsilon times the squared amplitude
        assert largest == pytest.approx(2.0 * np.sqrt(1 + (theta + 3.0) ** 2), rel=0.03)


def test_the_actuator_moves_at_its_rate_and_stops_at_its_bounds():
    config = PlantConfig(theta_min=-0.5, theta_max=2.0, theta_rate=20.0, theta_initial=0.0)
    applied, actual = 0.0, []
    for command in [5.0] * 4 + [-5.0] * 3 + [1.0] * 2:  # 0.1 a step
        _, _, applied = dynamics.advance(config.params(), 0, 1.0, 2.0, applied, command)
        actual.append(applied)
    np.testing.assert_allclose(actual, [0.1, 0.2, 0.3, 0.4, 0.3, 0.2, 0.1, 0.2, 0.3], atol=1e-15)
    at_once = replace(config, theta_rate=0.0).params()
    assert dynamics.advance(at_once, 0, 1.0, 2.0, 0.0, 5.0)[2] == 2.0
    assert dynamics.advance(at_once, 0, 1.0, 2.0, 0.0, -5.0)[2] == -0.5


def test_the_compiled_kernel_is_the_python_function():
    params = PlantConfig().params()
    compiled = dynamics.step(params, 123, 5.0, 1.5, THETA)
    assert compiled == pytest.approx(dynamics.step.py_func(params, 123, 5.0, 1.5, THETA), rel=1e-14)


def test_the_same_seed_gives_the_same_initial_state_within_the_training_range():
    states = np.array([dynamics.initial_state(seed) for seed in range(200)])
    np.testing.assert_array_equal(states[7], dynamics.initial_state(7))
    assert np.unique(states, axis=0).shape == (200, 2)
    assert np.abs(states).max() <= 3.0


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"mu": float("nan")}, "mu = nan: must be a finite number"),
        ({"mu": -1.0}, "mu = -1: must be 0 to 100 rad/s"),
        ({"mu": "fast"}, "mu: expected float, got 'fast'"),
        ({"initial_state": [1.0]}, "initial_state has 1 values"),
        ({"seed": 1.5}, "seed: expected int"),
        ({"seed": True}, "seed: expected int"),
    ],
)
def test_a_bad_value_is_refused_with_the_reason(values, message):
    with pytest.raises(ConfigError, match=message.replace("(", r"\(")):
        PlantConfig(**values)


def test_an_integer_is_taken_for_a_float():
    assert PlantConfig(mu=2).mu == 2.0
    assert type(PlantConfig(mu=2).mu) is float
