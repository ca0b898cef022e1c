"""Several knobs: one is the relay itself, limits and rates hold, coupled knobs find the optimum."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize

from koop_core.config.parameter import ConfigError
from koop_core.stream.arrival import Arrival
from relay_esc import directions, relay
from relay_esc.config import EscConfig
from relay_esc.directions import DIRECTIONS, EPSILON, FACTOR, DirectionState, Knobs

Array = NDArray[np.float64]
DT = 0.05
NEXT, RESTART, JOIN, RESUME = map(
    int, (Arrival.NEXT, Arrival.RESTART, Arrival.JOIN, Arrival.RESUME)
)


def config(**values: object) -> EscConfig:
    defaults = {"law": "adaptive", "dwell": 1.0, "tau_f": 0.4, "step_size": 0.005,
                "theta_min": -1.0, "theta_max": 1.0, "theta_initial": 0.3}  # fmt: skip
    return EscConfig(**{**defaults, **values})


def start(u: Array, epsilon: NDArray[np.int64]) -> DirectionState:
    return directions.start(u, epsilon, u, u)


def knobs_of(n: int, rate: float = math.inf) -> Knobs:
    ones = np.ones(n)
    return Knobs(-ones, ones, ones, np.full(n, rate), -ones, ones)


@pytest.mark.parametrize(
    "values",
    [{"law": "relay"}, {}, {"theta_initial": 1.2},  # from beyond its limits
     {"theta_scale": "log", "theta_min": 0.1, "theta_initial": 2.0}],
)  # fmt: skip
def test_one_knob_is_the_relay_to_the_last_bit(values: dict[str, Any]) -> None:
    chosen = config(**{"rate_limit": 0.02, **values})
    rng, p, knobs = np.random.default_rng(3), chosen.params(DT), chosen.knob_limits(DT)
    alone, several = chosen.initial(), chosen.initial_directions()
    begun = alone.output
    for k in range(3000):
        r = math.nan if rng.random() < 0.01 else float(rng.random() + 0.1)
        arrival = RESTART if k == 0 else int(rng.choice([NEXT, RESUME, JOIN], p=[0.98, 0.01, 0.01]))
        hold = bool(rng.random() < 0.02)
        alone, *expected = relay.answer(p, alone, arrival, False, False, r, hold)
        several, *answered = directions.answer(p, knobs, several, arrival, False, False, r, hold)
        assert (several.theta[0], answered) == (alone.output, expected)
    assert abs(alone.output - begun) > 0.0


@pytest.mark.parametrize(("n", "lines"), [(2, 0), (5, 0), (2, 1), (3, 2), (5, 4)])
def test_limits_lines_and_rates_hold_whatever_the_cost_does(n: int, lines: int) -> None:
    rng, rate = np.random.default_rng(n), 0.02
    p = config().params(DT)
    lower, upper = -rng.uniform(0.2, 1.0, n), rng.uniform(0.2, 1.0, n)
    scale, change = rng.uniform(0.3, 3.0, n), rate * rng.uniform(0.5, 2.0, n)
    u = rng.uniform(-0.2, 0.2, n)
    a = rng.standard_normal((lines, n))
    a /= np.linalg.norm(a * scale, axis=1)[:, None]
    b = a @ u + rng.uniform(0.0, 0.1, lines)
    knobs = Knobs(lower, upper, scale, change, lower, upper, a * scale, b)
    state, before, swept = start(u, rng.choice([-1, 1], n)), u.copy(), 0.0
    for k in range(5_000):
        r = math.nan if rng.random() < 0.01 else float(np.exp(rng.normal()))
        arrival = (
            RESTART if k == 0 else int(rng.choice([NEXT, RESUME, JOIN], p=[0.99, 0.005, 0.005]))
        )
        state, _, _ = directions.answer(
            p, knobs, state, arrival, False, False, r, bool(rng.random() < 0.02)
        )
        assert (state.output >= knobs.lower).all()
        assert (state.output <= knobs.upper).all()
        assert (np.abs(state.output - before) <= knobs.largest_change * (1.0 + 1e-9)).all()
        assert (a @ state.output <= b + 1e-9).all()  # a share of 1e-10 of its terms is rounding
        assert (a @ state.base <= b + 1e-9).all()
        swept = max(swept, float(np.abs(state.output - u).min()))
        before = state.output.copy()
    assert swept > 0.0  # every knob was moved


def seek(
    m: Array, u_star: Array, u: Array, steps: int, crossing: float = 20.0, floor: float = 0.01,
    noise: float = 0.0,
) -> Array:  # fmt: skip
    """Seek on r = |M (u - u*)|^2 + floor; return the mean of the knobs in the last third.

    A knob crosses its range in ``crossing`` dwell times; ``noise`` is of ln r.
    """
    n, rng = u.size, np.random.default_rng(0)
    p, knobs = config(step_size=2.0 / crossing / 20.0).params(DT), knobs_of(n)
    state, where = start(u, np.ones(n, dtype=np.int64)), []
    for k in range(steps):
        e = m @ (state.output - u_star)
        arrival = NEXT if k else RESTART
        r = (float(e @ e) + floor) * math.exp(noise * rng.standard_normal())
        state, _, _ = directions.answer(p, knobs, state, arrival, False, False, r, False)
        where.append(state.output.copy())
    assert np.allclose(state.directions @ state.directions.T, np.eye(n), atol=1e-9)
    return np.asarray(where[-steps // 3 :]).mean(axis=0)


@pytest.mark.parametrize("seed", range(3))
def test_coupled_knobs_of_unequal_worth_find_their_optimum(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q, _ = np.linalg.qr(rng.standard_normal((2, 2)))
    m, u_star = np.diag([1.0, 0.2]) @ q, rng.uniform(-0.6, 0.6, 2)
    at = seek(m, u_star, rng.uniform(-0.9, 0.9, 2), 8_000)
    assert np.linalg.norm(m @ (at - u_star)) < 0.05  # of a floor of 0.1


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_knobs_leave_a_corner_although_each_leg_reaches_a_limit(sense: float) -> None:
    m = np.array([[0.8, 0.6], [-0.3, 0.4]])  # a valley from one corner to the other
    u_star = sense * np.array([0.3, -0.3])
    at = seek(m, u_star, sense * np.array([1.0, -1.0]), 12_000, 4.0, floor=0.5, noise=0.3)
    assert np.linalg.norm(m @ (at - u_star)) < 0.35  # of 0.5 in the corner


@pytest.mark.parametrize("scale", ["linear", "log"])
@pytest.mark.parametrize("seed", range(3))
def test_the_best_within_lines_between_knobs_is_found(seed: int, scale: str) -> None:
    rng = np.random.default_rng(seed)
    q, _ = np.linalg.qr(rng.standard_normal((2, 2)))
    m, u_star, u = np.diag([1.0, 0.3]) @ q, np.array([0.6, -0.6]), rng.uniform(-0.5, 0.0, 2)
    if scale == "linear":
        a, b = np.array([[1.0, -2.0], [2.0, 0.5]]), np.array([1.0, 0.5])
        limits = {"theta_min": [-1.0] * 2, "constraint": "theta[0] <= 1 + 2 theta[1]; "
                  "2 theta[0] + 0.5 theta[1] <= 0.5", "theta_initial": u.tolist()}  # fmt: skip
    else:  # of u = ln theta
        a, b = np.array([[1.0, -1.0]]), np.array([math.log(1.5)])
        limits = {"theta_scale": "log", "theta_min": [math.exp(-1.0)] * 2, "theta_max": math.e,
                  "constraint": "1.5 theta[1] >= theta[0]",
                  "theta_initial": np.exp(np.minimum(u, u[::-1])).tolist()}  # fmt: skip
    several = config(step_size=0.005, rate_limit=0.2, **limits)
    p, knobs, state = several.knob(0).params(DT), several.knob_limits(DT), None
    floor, path = 0.02, []
    for _ in range(8_000):
        first, state = state is None, state or several.initial_directions()
        e = m @ (state.output - u_star)
        r, arrival = float(e @ e) + floor, RESTART if first else NEXT
        state, _, _ = directions.answer(p, knobs, state, arrival, False, False, r, False)
        path.append(state.output.copy())
        assert (a @ path[-1] <= b).all()
    best = minimize(
        lambda v: float(np.sum((m @ (v - u_star)) ** 2)), np.zeros(2), bounds=[(-1.0, 1.0)] * 2,
        constraints={"type": "ineq", "fun": lambda v: b - a @ v},
    )  # fmt: skip
    assert (a @ u_star > b).any()
    at = np.mean(path[-2_500:], axis=0)
    assert float(np.sum((m @ (at - u_star)) ** 2)) + floor < 1.2 * (best.fun + floor)


def test_theta_begins_within_a_sharp_corner_between_a_line_and_a_limit() -> None:
    several = config(
        theta_min=[0.0, 0.662], theta_max=[0.756, 1.0], theta_initial=[0.763, 0.944],
        step_size=[1.2e-4, 1.7e-4], rate_limit=0.06,
        constraint="0.9804 theta[0] >= 0.5617 + 0.1968 theta[1]",
    )  # fmt: skip
    base = several.initial_directions().base
    assert 0.9804 * base[0] >= 0.5617 + 0.1968 * base[1]
    assert 0.662 <= base[1] <= 1.0
    assert base[0] == 0.756


def test_a_knob_that_does_nothing_does_not_keep_the_other_from_its_optimum() -> None:
    at = seek(np.array([[0.0, 1.0]]), np.array([0.0, 0.5]), np.array([0.2, -0.8]), 6_000)
    assert abs(at[1] - 0.5) < 0.05


def test_a_round_along_a_valley_makes_the_valley_a_direction_and_widens_the_swings() -> None:
    p, knobs = config().params(DT), knobs_of(3)
    state = start(np.zeros(3), np.ones(3, dtype=np.int64))
    state.own[:, FACTOR] = 0.2
    valley = np.array([0.6, 0.0, 0.8])
    state.base[:] = 0.5 * valley
    directions.rotate(p, knobs, state)
    assert np.allclose(state.directions[2], valley)  # the one that was most like it
    assert np.allclose(state.directions @ state.directions.T, np.eye(3))
    assert (state.own[:, FACTOR] == 1.0).all()
    kept = state.directions.copy()
    state.base[:] += 0.4 * DIRECTIONS.progress * p.step_size * p.dwell_samples * valley
    directions.rotate(p, knobs, state)  # a round that went nowhere
    assert (state.directions == kept).all()
    assert (state.begin == state.base).all()


def test_nothing_is_held_while_theta_goes_to_where_the_next_direction_begins() -> None:
    p, knobs, rng = config().params(DT), knobs_of(2, 0.02), np.random.default_rng(0)
    state, active, held = start(np.full(2, 0.5), np.ones(2, np.int64)), set(), []
    for k in range(2_000):
        r = float(state.output @ state.output + 0.01) * math.exp(0.1 * rng.standard_normal())
        arrival = NEXT if k else RESTART
        state, holding, _ = directions.answer(p, knobs, state, arrival, False, False, r, False)
        active.add(state.active)
        held.append(holding)
    assert active == {0, 1}
    assert not any(held)


def test_a_knob_begins_with_its_own_sense() -> None:
    state = start(np.zeros(2), np.array([1, -1]))
    assert state.relay.epsilon == 1
    assert list(state.own[:, EPSILON]) == [1.0, -1.0]


def test_a_configuration_of_several_knobs_has_limits_steps_and_rates_of_each() -> None:
    several = config(
        theta_scale="log", theta_min=[0.1, 1.0], theta_max=[1.0, 8.0], theta_initial=[0.5, 2.0],
        step_size=[0.01, 0.02], rate_limit=[0.0, 3.0],
    )  # fmt: skip
    knobs = several.knob_limits(DT)
    np.testing.assert_allclose(np.exp([knobs.lower, knobs.upper]), [[0.1, 1.0], [1.0, 8.0]])
    assert knobs.scale.tolist() == [1.0, 2.0]
    assert knobs.largest_change.tolist() == [math.inf, 3.0 * DT]
    state, p = several.initial_directions(), several.knob(0).params(DT)
    assert state.theta.tolist() == [0.5, 2.0]
    for k in range(2000):
        r = float((np.log(state.theta) - [-3.0, 0.5]) @ (np.log(state.theta) - [-3.0, 0.5])) + 0.1
        state, _, _ = directions.answer(
            p, knobs, state, NEXT if k else RESTART, False, False, r, False
        )
        assert (state.theta >= [0.1, 1.0]).all()
        assert (state.theta <= [1.0, 8.0]).all()
    assert state.theta[0] == pytest.approx(0.1, rel=0.1)  # the optimum is beyond its limit
    assert state.theta[1] == pytest.approx(math.exp(0.5), rel=0.2)
    begin = directions.memory(state)
    again = replace(several, begin=begin).initial_directions()  # as after a restart
    assert directions.memory(again) == begin
    assert again.theta.tolist() == pytest.approx(state.theta.tolist(), rel=1e-15)
    for wrong in (begin[:-1], (*begin, 0.0), (begin[0], 0.0, *begin[2:])):
        with pytest.raises(ConfigError, match="begin: is not what a controller goes on from"):
            replace(several, begin=wrong)
    before = state.output.copy()
    state = directions.reset(knobs, state, several.initial_directions())
    assert state.output.tolist() == before.tolist()
    assert state.relay.since_flip == -math.ceil(abs(before[1] - math.log(2.0)) / (3.0 * DT))
    for k in range(20):
        state, _, _ = directions.answer(p, knobs, state, NEXT, False, False, 1.0, k < 15)
    assert state.theta[0] == pytest.approx(0.5, rel=0.1)
    with pytest.raises(ConfigError, match=r"theta_min = 1 must be below theta_max = 0\.5"):
        config(theta_min=[0.1, 1.0], theta_max=0.5, theta_initial=0.3)
    for text, wrong in (
        ("theta[0] + theta[1] <= 3", r"^constraint: with theta_scale log a line is a ratio of two"),
        ("theta[0] <= 0.2 theta[1]", r"^theta_initial = \[0.5, 2\]: must lie within theta\[0\] <="),
        ("theta[0] >= theta[2]", r"^constraint = .*: unknown knob 'theta\[2\]'"),
    ):
        with pytest.raises(ConfigError, match=wrong):
            replace(several, constraint=text)
    with pytest.raises(
        ConfigError, match=r"^constraint: no theta within theta_min and theta_max k"
    ):
        config(theta_initial=[-2.0, 0.0], rate_limit=0.1, constraint="theta[0] <= theta[1] - 2")
    with pytest.raises(ConfigError, match="are for one knob"):
        config(theta_initial=[0.1, 0.3], widest=[-2.0, 2.0])
