"""The sums of a run against those of the same recording, and where a loop does not excite."""

import numpy as np
import pytest

from koop_core.kernels import njit
from koopman_lifter.edmd import Gram, RankDeficient, edmd
from koopman_lifter.observables import Monomials
from koopman_lifter.running_sums import RunningSums, add

TURN = 0.2


@njit()
def add_all(sums, first, lifted):
    for k in range(lifted.shape[0]):
        add(sums, first + k, lifted[k])


def run(sums, states, first=0, block=500):
    """Take states, shape (n, M), in blocks."""
    lifted = np.ascontiguousarray(sums.past.observables.lift(states).T)
    for begin in range(0, lifted.shape[0], block):
        add_all(sums.block, first + begin, lifted[begin : begin + block])
        sums.close_block()


def swinging(count, turn=TURN, decay=1.0, seed=0, noise=0.1):
    """Return a driven linear oscillation about (1, 2), shape (2, count)."""
    rng = np.random.default_rng(seed)
    a = decay * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    x = np.empty((2, count))
    x[:, 0] = 1.0, 0.0
    for k in range(1, count):
        x[:, k] = a @ x[:, k - 1] + noise * rng.standard_normal(2)
    return x + np.array([[1.0], [2.0]])


def turn_of(gram):
    """Return the turn of a step [rad] of the linear part."""
    return np.abs(np.angle(np.linalg.eigvals(edmd(gram.of_degree(1)).matrix))).max()


@pytest.mark.parametrize("degree", [1, 3])
def test_without_forgetting_the_run_has_the_model_of_its_recording(degree):
    states = swinging(20_000, decay=0.99)
    batch = Gram.empty(Monomials(2, degree))
    batch.add_trajectory(states)
    sums = RunningSums(batch.observables, 0.0)
    run(sums, states)
    assert sums.gram.pairs == batch.pairs == 19_999
    for name in ("xx", "yx", "yy"):
        np.testing.assert_allclose(
            sums.gram.equilibrated(getattr(sums.gram, name)),
            batch.equilibrated(getattr(batch, name)),
            rtol=0.0,
            atol=1e-9,  # the bound that identification in operation has to keep
        )
    np.testing.assert_allclose(edmd(sums.gram).scaled, edmd(batch).scaled, rtol=0.0, atol=1e-9)
    lifted = batch.observables.lift(states) / batch.scale[:, None]
    least_squares = np.linalg.lstsq(lifted[:, :-1].T, lifted[:, 1:].T, rcond=None)[0].T
    np.testing.assert_allclose(edmd(sums.gram).scaled, least_squares, rtol=0.0, atol=1e-9)


def test_a_lost_or_unusable_sample_makes_no_pair_across_it():
    observables = Monomials(2, 1)
    states = swinging(60)
    sums = RunningSums(observables, 0.0)
    lifted = observables.lift(states)
    for k in range(60):
        z = lifted[:, k].copy()
        if k == 20:
            continue
        if k == 40:
            z[2] = np.nan
        add(sums.block, k, z)
    pieces = Gram.empty(observables)
    for part in (slice(0, 20), slice(21, 40), slice(41, 60)):
        pieces.add_trajectory(states[:, part])
    assert sums.gram.pairs == pieces.pairs
    np.testing.assert_allclose(sums.gram.yx, pieces.yx, rtol=1e-12)


def test_a_block_that_overflows_is_left_out():
    sums = RunningSums(Monomials(2, 1), 0.1)
    run(sums, swinging(1000))
    before = sums.gram
    run(sums, np.full((2, 500), 1e200), first=5000)
    assert sums.gram.pairs == before.pairs
    np.testing.assert_array_equal(sums.gram.xx, before.xx)


def test_what_is_seen_again_is_forgotten():
    sums = RunningSums(Monomials(2, 2), 0.1)
    run(sums, swinging(20_000, decay=0.99))
    assert abs(turn_of(sums.gram) - TURN) < 0.005
    run(sums, swinging(20_000, turn=1.1 * TURN, decay=0.99, seed=1), first=10**6)
    # 40 blocks of a tenth leave e^-4.2 = 1.5 % of the difference; the rest is noise
    assert abs(turn_of(sums.gram) - 1.1 * TURN) < 0.002
    assert sums.gram.pairs < 1.5 * 500 / 0.1


def test_a_weaker_oscillation_is_followed():
    sums = RunningSums(Monomials(2, 1), 0.1)
    run(sums, swinging(20_000, decay=0.99))
    weak = swinging(50_000, turn=1.1 * TURN, decay=0.99, seed=1, noise=0.01)
    run(sums, weak, first=10**6)
    assert abs(turn_of(sums.gram) - 1.1 * TURN) < 0.002


def test_a_converged_loop_leaves_the_model_as_it_was():
    """A million samples that say nothing: where plain forgetting loses all that it knew."""
    observables, share = Monomials(2, 2), 0.1
    sums, plain = RunningSums(observables, share), RunningSums(observables, 0.0)
    run(sums, swinging(20_000, decay=0.99))
    plain.past, before = sums.past, edmd(sums.gram).matrix
    rest = np.array([[1.0], [2.0]]) + 1e-6 * swinging(1000)
    for first in range(0, 10**6, 1000):
        run(sums, rest, 10**6 + first, block=1000)
        for name in ("xx", "yx", "yy"):
            setattr(plain.past, name, (1.0 - share) * getattr(plain.past, name))
        run(plain, rest, 10**6 + first, block=1000)
    np.testing.assert_allclose(edmd(sums.gram).matrix, before, rtol=0.0, atol=1e-6)
    with pytest.raises(RankDeficient):
        edmd(plain.gram)


def test_what_a_weak_excitation_does_not_show_is_kept():
    """One direction rests for ten thousand blocks while the other swings."""
    observables = Monomials(2, 1)
    a = np.array([[0.9, 0.2], [0.0, 0.7]])
    rng = np.random.default_rng(0)

    def states(count, noise):
        x = np.zeros((2, count))
        for k in range(1, count):
            x[:, k] = a @ x[:, k - 1] + noise * rng.standard_normal(2)
        return x

    sums = RunningSums(observables, 0.1)
    run(sums, states(20_000, np.array([1.0, 1.0])))
    one_way = states(200, np.array([1.0, 0.0]))
    for first in range(0, 2_000_000, 200):
        run(sums, one_way, 10**6 + first, block=200)
    np.testing.assert_allclose(edmd(sums.gram).matrix[1:, 1:], a, atol=0.15)  # of 200 samples
    assert abs(edmd(sums.gram).matrix[2, 2] - 0.7) < 0.02
