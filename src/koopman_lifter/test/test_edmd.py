"""EDMD and the modes against systems whose Koopman operator is known."""

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize

from koopman_lifter.edmd import Gram, edmd
from koopman_lifter.modes import Modes, decompose, projector, select
from koopman_lifter.observables import Monomials


def trajectories(step, starts, length):
    for start in starts:
        states = np.empty((start.size, length))
        states[:, 0] = start
        for k in range(1, length):
            states[:, k] = step(states[:, k - 1])
        yield states


def summed(observables, data):
    gram = Gram.empty(observables)
    for states in data:
        gram.add_trajectory(states)
    return gram


LINEAR = np.array([[0.95, 0.20], [-0.15, 0.90]])


def linear_data(scale=1.0, count=30):
    starts = np.random.default_rng(0).uniform(-1, 1, (count, 2)) * scale
    return list(trajectories(lambda x: LINEAR @ x, starts, 25))


POLYNOMIAL = 0.9, 0.5


def polynomial_data():
    """Return the sums over x1' = a x1, x2' = b x2 + (b - a^2) x1^2 (Tu 2014)."""
    a, b = POLYNOMIAL
    starts = np.random.default_rng(1).uniform(-2, 2, (40, 2))

    def step(x):
        return np.array([a * x[0], b * x[1] + (b - a**2) * x[0] ** 2])

    return summed(Monomials(2, 2), trajectories(step, starts, 12))


def test_a_linear_system_gives_its_matrix_and_the_products_of_its_eigenvalues():
    """On monomials to degree 3 the eigenvalues are l1^i l2^j with i + j <= 3 (Budisic 2012)."""
    gram = summed(Monomials(2, 3), linear_data())
    koopman = edmd(gram)
    np.testing.assert_allclose(koopman.matrix[1:3, 1:3], LINEAR, atol=1e-9)
    np.testing.assert_allclose(koopman.matrix[1:3, 3:], 0.0, atol=1e-9)
    l1, l2 = np.linalg.eigvals(LINEAR)
    expected = [l1**i * l2**j for i in range(4) for j in range(4 - i)]
    actual = decompose(koopman, gram).eigenvalues
    distance = np.abs(np.array(expected)[:, None] - actual[None, :])
    assert distance.min(axis=1).max() < 1e-8  # the Gram matrix squares a condition of about 1e3
    assert distance.min(axis=0).max() < 1e-8


def test_a_polynomial_system_with_a_known_invariant_subspace():
    """Of x1, x2 and x1^2."""
    a, b = POLYNOMIAL
    rows = edmd(polynomial_data()).matrix[[1, 2, 3]]
    expected = np.zeros((3, 6))
    expected[0, 1], expected[1, 2], expected[1, 3], expected[2, 3] = a, b, b - a**2, a**2
    np.testing.assert_allclose(rows, expected, atol=1e-9)


def test_units_of_eight_decades_do_not_spoil_the_solution():
    """States of size 300 give cubes of size 3e7; an absolute cut-off would drop observables."""
    koopman = edmd(summed(Monomials(2, 3), linear_data(scale=300.0)))
    np.testing.assert_allclose(koopman.matrix[1:3, 1:3], LINEAR, atol=1e-8)


def test_the_solution_is_the_least_squares_one_on_noisy_data():
    rng = np.random.default_rng(2)
    data = [states + 0.1 * rng.normal(size=states.shape) for states in linear_data()]
    observables = Monomials(2, 2)
    koopman = edmd(summed(observables, data))
    before = np.hstack([observables.lift(states[:, :-1]) for states in data])
    after = np.hstack([observables.lift(states[:, 1:]) for states in data])
    expected = np.linalg.lstsq(before.T, after.T, rcond=None)[0].T
    np.testing.assert_allclose(koopman.matrix, expected, rtol=1e-8, atol=1e-10)


def test_no_pair_spans_two_trajectories():
    observables = Monomials(2, 3)
    data = linear_data(count=6)
    whole = summed(observables, data)
    assert whole.pairs == sum(states.shape[1] - 1 for states in data)
    lifted = [observables.lift(states) for states in data]
    expected = sum(z[:, 1:] @ z[:, :-1].T for z in lifted)
    np.testing.assert_allclose(whole.yx, expected, rtol=1e-9)


def test_energies_are_the_mean_square_of_the_modal_coefficients():
    observables = Monomials(2, 3)
    data = linear_data()
    gram = summed(observables, data)
    modes = decompose(edmd(gram), gram)
    lifted = np.hstack([observables.lift(states[:, :-1]) for states in data])
    coefficients = np.linalg.pinv(modes.vectors) @ lifted
    # V's own condition enters the pseudo-inverse of this direct computation
    np.testing.assert_allclose(modes.energies, (np.abs(coefficients) ** 2).mean(axis=1), rtol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(modes.vectors, axis=0), 1.0)


@pytest.mark.parametrize(
    ("trajectory", "message"),
    [
        (np.zeros((3, 9)), r"must have shape \(2, M\)"),
        (np.full((2, 9), np.nan), "not finite"),
    ],
)
def test_bad_data_is_refused_and_leaves_the_sums_alone(trajectory, message):
    gram = summed(Monomials(2, 2), linear_data(count=3))
    before = gram.xx.copy()
    with pytest.raises(ValueError, match=message):
        gram.add_trajectory(trajectory)
    np.testing.assert_array_equal(gram.xx, before)


def test_data_that_do_not_determine_the_operator_are_refused():
    with pytest.raises(ValueError, match="9 snapshot pairs cannot determine 10 observables"):
        edmd(summed(Monomials(2, 3), [np.random.default_rng(0).normal(size=(2, 10))]))
    line = np.linspace(0.1, 1.0, 200)
    with pytest.raises(ValueError, match="do not excite every observable"):
        edmd(summed(Monomials(2, 3), [np.stack((line, 2 * line))]))


@pytest.mark.parametrize("factor", [0.999, 0.9, 0.05], ids=["lasting", "dying", "dead at once"])
def test_the_sum_a_step_later_is_exact_however_fast_the_state_dies_away(factor):
    """With the factor 0.05 all but 1e-8 of the sum of x^6 is its first sample."""
    observables = Monomials(1, 3)
    data = list(trajectories(lambda x: factor * x, np.array([[3.0], [-2.0], [1.5]]), 30))
    after = np.hstack([observables.lift(states[:, 1:]) for states in data])
    np.testing.assert_allclose(summed(observables, data).yy, after @ after.T, rtol=1e-13)


def test_eigenfunctions_of_a_linear_system_have_no_residual():
    gram = summed(Monomials(2, 3), linear_data())
    assert decompose(edmd(gram), gram).residuals.max() < 1e-6  # squares of it are rounding


def test_spurious_modes_are_told_by_their_residual():
    """1, x1, x2 + x1^2 and x1^2 are invariant; x1 x2 and x2^2 lead out of the monomials."""
    (a, b), gram = POLYNOMIAL, polynomial_data()
    modes = decompose(edmd(gram), gram)
    true = np.abs(modes.eigenvalues[:, None] - [1.0, a, b, a**2]).min(axis=1) < 1e-6
    assert true.sum() == 4
    assert modes.residuals[true].max() < 1e-6
    assert modes.residuals[~true].min() > 0.05


def test_a_mode_of_nothing_but_noise_has_a_residual_of_one():
    """phi(x_{k+1}) and phi(x_k) of white noise are independent: lambda = 0, res = 1."""
    rng = np.random.default_rng(4)
    angle = 0.1 * np.arange(20_000)
    states = np.stack((np.cos(angle), np.sin(angle), rng.normal(size=angle.size)))
    gram = summed(Monomials(3, 1), [states])
    modes = decompose(edmd(gram), gram)
    noise = int(np.argmin(np.abs(modes.eigenvalues)))
    assert modes.residuals[noise] == pytest.approx(1.0, abs=0.03)  # 4 deviations of 1 / sqrt(M)
    assert np.delete(modes.residuals, noise).max() < 0.03


def test_residuals_are_the_least_error_of_their_eigenfunctions_on_the_data():
    """The eigenvalue of a least-squares K is the best factor from phi(x_k) to phi(x_{k+1})."""
    rng = np.random.default_rng(5)
    data = [states + 0.05 * rng.normal(size=states.shape) for states in linear_data()]
    observables = Monomials(2, 2)
    gram = summed(observables, data)
    koopman = edmd(gram)
    modes = decompose(koopman, gram)
    before = np.hstack([observables.lift(states[:, :-1]) for states in data])
    after = np.hstack([observables.lift(states[:, 1:]) for states in data])
    values, left = scipy.linalg.eig(koopman.matrix, left=True, right=False)
    for value, w in zip(values, left.T, strict=True):
        now, then = w.conj() @ before, w.conj() @ after

        def error(factor, now=now, then=then):
            return np.linalg.norm(then - (factor[0] + 1j * factor[1]) * now) / np.linalg.norm(now)

        least = scipy.optimize.minimize(error, [0.5, 0.5], tol=1e-12)
        j = int(np.argmin(np.abs(modes.eigenvalues - value)))
        assert least.x[0] + 1j * least.x[1] == pytest.approx(modes.eigenvalues[j], abs=1e-5)
        assert modes.residuals[j] == pytest.approx(least.fun, abs=1e-6)


def modes_of(eigenvalues, energies):
    eigenvalues = np.array(eigenvalues, dtype=complex)
    vectors = np.eye(eigenvalues.size, dtype=complex)
    return Modes(eigenvalues, vectors, np.array(energies, float), np.zeros(eigenvalues.size))


@pytest.mark.parametrize(
    ("count", "kept"), [(1, [0]), (2, [0, 2, 3]), (3, [0, 2, 3]), (4, [0, 1, 2, 3])]
)
def test_the_most_energetic_modes_are_kept_and_no_pair_is_split(count, kept):
    modes = modes_of([1.0, 0.9, 0.8 + 0.1j, 0.8 - 0.1j], [9.0, 1.0, 5.0, 5.0])
    assert np.flatnonzero(select(modes, count)).tolist() == kept


def test_the_real_projector_measures_the_norm_of_the_complex_projection():
    gram = summed(Monomials(2, 3), linear_data())
    modes = decompose(edmd(gram), gram)
    kept = select(modes, 6)
    v_dom = modes.vectors[:, kept]
    real = projector(v_dom, modes.eigenvalues[kept])
    assert real.shape == (kept.sum(), 10)
    for z in np.random.default_rng(3).normal(size=(5, 10)):
        direct = np.linalg.norm(np.linalg.pinv(v_dom) @ z)
        assert np.linalg.norm(real @ z) == pytest.approx(direct, rel=1e-8)
