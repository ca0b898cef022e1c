"""The baseline controllers on static maps, where the right answer is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from koop_study.controllers import adaptive, perturbation
from koop_study.controllers.adaptive import AdaptiveConfig
from koop_study.controllers.perturbation import PerturbationConfig
from relay_esc.config import EscConfig

OPTIMUM = -1.3
ESC = EscConfig(tau_f=1.0)


def cost(theta: float) -> float:
    return 1.0 + (theta - OPTIMUM) ** 2


def adaptive_path(config: AdaptiveConfig, seconds: float, esc: EscConfig = ESC) -> np.ndarray:
    state, params = adaptive.initial(esc), config.params(esc)
    path = np.empty(round(seconds / esc.dt))
    for k in range(path.size):
        state = adaptive.step(params, state, cost(state.theta))
        path[k] = state.theta
    return path


def test_adaptive_relay_narrows_its_cycle_to_the_smallest_step() -> None:
    path = adaptive_path(AdaptiveConfig(step_ratio=0.1), 900.0)
    wide = adaptive_path(AdaptiveConfig(step_ratio=1.0), 900.0)
    tail, wide_tail = path[-60_000:], wide[-60_000:]
    # a leg of 15 s at dt/15 a sample is 1 wide; at a tenth of the step it is a tenth
    assert np.ptp(wide_tail) == pytest.approx(1.0, abs=0.5)
    assert np.ptp(tail) < 0.3
    assert abs(tail.mean() - OPTIMUM) < 0.15


def test_adaptive_relay_grows_its_step_back_when_the_optimum_is_far() -> None:
    esc = replace(ESC, theta_initial=5.0)
    path = adaptive_path(AdaptiveConfig(step_ratio=0.1), 60.0, esc)
    # a monotone descent is one long leg at full step: dt / 15 a sample
    assert path[-1] == pytest.approx(5.0 - 60.0 / 15.0, abs=1e-2)


def test_hysteresis_ignores_a_rise_that_is_small_relative_to_the_cost() -> None:
    params = AdaptiveConfig(hysteresis=0.1).params(ESC)
    state = adaptive.initial(ESC)
    for k in range(8000):  # 40 s of a cost that rises by 0.1 % a second: 0.1 % over its average
        state = adaptive.step(params, state, 1.0 + 1e-3 * k * ESC.dt)
    assert state.epsilon == 1
    assert adaptive.step.py_func(params, state, 2.0).epsilon == -1


def test_perturbation_seeks_the_optimum_of_a_static_map() -> None:
    config = PerturbationConfig(amplitude=0.2, omega=1.0, gain=2.0, omega_w=0.3, omega_g=0.3)
    state, params = perturbation.initial(ESC), config.params(ESC)
    for _ in range(120_000):
        state = perturbation.step(params, state, cost(state.theta))
    assert state.centre == pytest.approx(OPTIMUM, abs=0.05)
    assert abs(state.theta - state.centre) <= 0.2 + 1e-12


def test_perturbation_on_the_logarithm_does_not_see_the_scale() -> None:
    config = PerturbationConfig()
    params = config.params(ESC)
    one, other = perturbation.initial(ESC), perturbation.initial(ESC)
    for _ in range(5000):
        one = perturbation.step(params, one, cost(one.theta))
        other = perturbation.step(params, other, 1e20 * cost(other.theta))
    assert other.theta == pytest.approx(one.theta, abs=1e-9)


@pytest.mark.parametrize("module", [adaptive, perturbation])
def test_compiled_and_plain_step_agree(module) -> None:
    config = AdaptiveConfig() if module is adaptive else PerturbationConfig()
    params, state = config.params(ESC), module.initial(ESC)
    plain = state
    for r in np.random.default_rng(2).uniform(1.0, 2.0, 5000):
        state, plain = module.step(params, state, r), module.step.py_func(params, plain, r)
    assert state == pytest.approx(plain, rel=1e-12)
