"""Estimates of K for noisy data against the same estimates on the data matrices, and the truth."""

import numpy as np
import pytest
import scipy.linalg

from koopman_lifter.edmd import Gram
from koopman_lifter.estimators import ESTIMATORS, forward_backward, total_least_squares
from koopman_lifter.observables import Monomials

UNBIASED = ["total-least-squares", "forward-backward"]


def oscillation(modulus, angle, count, noise, seed, runs=1):
    """x_k = modulus^k (cos, sin)(k angle + phase) + (3, -1), with noise, shape (2, count)."""
    rng = np.random.default_rng(seed)
    k = np.arange(count)
    for phase in rng.uniform(0, 2 * np.pi, runs):
        x = modulus**k * np.stack((np.cos(k * angle + phase), np.sin(k * angle + phase)))
        yield x + np.array([[3.0], [-1.0]]) + noise * rng.normal(size=x.shape)


def summed(data, degree=1):
    data = list(data)
    gram = Gram.empty(Monomials(data[0].shape[0], degree))
    for states in data:
        gram.add_trajectory(states)
    return gram


def found(name, gram):
    """Return the eigenvalue of largest imaginary part."""
    values = np.linalg.eigvals(ESTIMATORS[name](gram).matrix)
    return values[np.argmax(values.imag)]


def matrices(data, observables):
    data = list(data)
    before = np.hstack([observables.lift(states[:, :-1]) for states in data])
    after = np.hstack([observables.lift(states[:, 1:]) for states in data])
    return before, after


@pytest.mark.parametrize("degree", [1, 2])
def test_total_least_squares_is_that_of_the_stacked_snapshots(degree):
    """Hemati et al. 2017: both sides are projected on the leading right singular vectors."""
    data = list(oscillation(0.99, 0.2, 60, 0.1, 0, runs=20))
    observables = Monomials(2, degree)
    x, y = (side[1:] for side in matrices(data, observables))
    mean_x, mean_y = x.mean(axis=1, keepdims=True), y.mean(axis=1, keepdims=True)
    x, y = x - mean_x, y - mean_y
    size = np.sqrt(0.5 * (x.var(axis=1) + y.var(axis=1)))[:, None]
    *_, rows = np.linalg.svd(np.vstack((x / size, y / size)), full_matrices=False)
    leading = rows[: x.shape[0]].T
    expected = size * ((y / size) @ leading @ np.linalg.pinv((x / size) @ leading)) / size.T
    matrix = total_least_squares(summed(data, degree)).matrix
    np.testing.assert_allclose(matrix[1:, 1:], expected, atol=1e-9)
    np.testing.assert_allclose(matrix[1:, :1], mean_y - expected @ mean_x, atol=1e-9)
    np.testing.assert_array_equal(matrix[0], np.eye(1, matrix.shape[0])[0])


@pytest.mark.parametrize("degree", [1, 2])
def test_forward_backward_is_the_root_of_both_estimates_on_the_data(degree):
    data = list(oscillation(0.99, 0.2, 60, 0.05, 1, runs=20))
    x, y = matrices(data, Monomials(2, degree))
    forward = np.linalg.lstsq(x.T, y.T, rcond=None)[0].T
    backward = np.linalg.lstsq(y.T, x.T, rcond=None)[0].T
    expected = scipy.linalg.sqrtm(forward @ np.linalg.inv(backward))
    # every oscillation turns by less than 90 degrees a step, so the principal root is right
    np.testing.assert_allclose(
        forward_backward(summed(data, degree)).matrix, expected.real, atol=1e-8
    )


@pytest.mark.parametrize("noise", [0.1, 0.3])
@pytest.mark.parametrize("name", UNBIASED)
def test_noise_makes_least_squares_see_damping_that_is_not_there_and_the_others_not(name, noise):
    """G grows by the noise's variance: |lambda| shrinks by 1 + its ratio to the oscillation's."""
    truth = 0.9999 * np.exp(0.1j)
    gram = summed(oscillation(0.9999, 0.1, 2000, noise, 2, runs=10))
    shrunk = abs(found("least-squares", gram))
    strength = np.mean(0.9999 ** (2 * np.arange(2000))) / 2.0  # variance of each channel
    assert shrunk == pytest.approx(0.9999 / (1.0 + noise**2 / strength), abs=3e-3)
    # 20 000 pairs: deviation of the estimate about noise^2 / (strength sqrt(M)), 2e-3 at most
    assert abs(found(name, gram) - truth) < 0.05 * (0.9999 - shrunk) + 2e-3 * noise


@pytest.mark.parametrize("angle", [0.3, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("name", ESTIMATORS)
def test_without_noise_all_find_the_truth_however_fast_it_turns(name, angle):
    """From 90 degrees a step on the root nearest to 1 is the wrong one."""
    gram = summed(oscillation(0.98, angle, 200, 0.0, 3))
    assert found(name, gram) == pytest.approx(0.98 * np.exp(1j * angle), abs=1e-8)


def test_a_factor_that_is_negative_stays_negative():
    gram = summed([(-0.9) ** np.arange(60)[None, :] + 2.0])
    values = np.linalg.eigvals(forward_backward(gram).matrix)
    np.testing.assert_allclose(np.sort(values), [-0.9, 1.0], atol=1e-8)


@pytest.mark.parametrize("name", UNBIASED)
def test_a_channel_of_nothing_but_noise_leaves_the_others_alone(name):
    rng = np.random.default_rng(4)
    clean = next(oscillation(1.0, 0.1, 20_000, 0.0, 5))
    gram = summed([np.vstack((clean, rng.normal(size=clean.shape[1])))])
    koopman = ESTIMATORS[name](gram)
    assert np.isrealobj(koopman.matrix)
    values = np.linalg.eigvals(koopman.matrix)
    assert np.abs(values - np.exp(0.1j)).min() < 2e-3


def test_data_that_do_not_determine_an_estimate_are_refused():
    white = np.random.default_rng(0).normal(size=(1, 40))
    with pytest.raises(ValueError, match="do not excite every observable"):
        forward_backward(summed([np.vstack((white, 2 * white))]))
    with pytest.raises(ValueError, match="is not determined by the data"):
        forward_backward(summed([np.array([[x, 0.0]]) for x in (1.0, -1.0, 2.0, -2.0)]))
    unrelated = [np.array([[x, y]]) for x in (1.0, -1.0) for y in (2.0, -2.0)]
    with pytest.raises(ValueError, match="is not determined by the data"):
        total_least_squares(summed(unrelated))
