"""Monomials against direct powers."""

import numpy as np
import pytest

from koopman_lifter.observables import Monomials, lift_into


def test_the_paper_s_order():
    names = Monomials(2, 3).names(("x", "y"))
    assert names == ["1", "x", "y", "x^2", "x*y", "y^2", "x^3", "x^2*y", "x*y^2", "y^3"]


@pytest.mark.parametrize(("n", "degree", "p"), [(1, 5, 6), (2, 3, 10), (3, 2, 10), (4, 5, 126)])
def test_lifting_is_the_product_of_powers(n, degree, p):
    observables = Monomials(n, degree)
    assert observables.p == p
    states = np.random.default_rng(0).uniform(-2, 2, (n, 7))
    expected = np.prod(states[None, :, :] ** observables.exponents[:, :, None], axis=1)
    np.testing.assert_allclose(observables.lift(states), expected, rtol=1e-13)
    assert len({tuple(row) for row in observables.exponents}) == p


def test_the_kernel_lifts_as_the_array_function_to_the_last_bit():
    observables = Monomials(3, 4)
    z = np.empty(observables.p)
    for state in np.random.default_rng(1).normal(size=(20, 3)) * 10:
        lift_into(observables.parent, observables.factor, state, z)
        np.testing.assert_array_equal(z, observables.lift(state))


def test_a_state_of_another_length_is_refused():
    with pytest.raises(ValueError, match=r"states must have shape \(2,\)"):
        Monomials(2, 3).lift([1.0, 2.0, 3.0])
