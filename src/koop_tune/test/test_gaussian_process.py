"""The Gaussian process of a map: the one of scikit-learn, to the last bit."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

from koop_tune.excitation.gaussian_process import GaussianProcess, Kernel, log_likelihood

START = Kernel(1.0, 0.3, 1e-4)
LOW, HIGH = Kernel(0.01, 0.02, 1e-6), Kernel(30.0, 3.0, 0.25)
CONSTANT, LENGTH, WHITE = zip(LOW, HIGH, strict=True)
PLACES = np.linspace(0.0, 1.0, 33)
# scikit-learn says so where the best is at a bound, which is an answer here
pytestmark = pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")


@pytest.mark.parametrize("count", [2, 9, 40])
def test_it_is_the_process_of_scikit_learn_to_the_last_bit(count):
    rng = np.random.default_rng(count)
    u = np.r_[rng.uniform(-0.2, 1.2, count - 1), 0.375]
    u[0] = u[-1]  # theta was there twice
    y = 5.0 * np.abs(u - 0.375) + rng.normal(0.0, 0.2, count)
    y -= y.mean()
    variance = rng.uniform(0.003, 0.3, count) ** 2
    process = GaussianProcess(u, y, variance, START, LOW, HIGH)

    kernel = ConstantKernel(START.constant, CONSTANT) * Matern(
        START.length, LENGTH, nu=1.5
    ) + WhiteKernel(START.white, WHITE)
    reference = GaussianProcessRegressor(
        kernel, alpha=variance, n_restarts_optimizer=1, random_state=0
    ).fit(u[:, None], y)
    assert tuple(np.log(process.kernel)) == pytest.approx(reference.kernel_.theta, abs=1e-12)
    for ours, deviates in ((process.predict, "std"), (process.predict_together, "cov")):
        theirs = reference.predict(PLACES[:, None], **{f"return_{deviates}": True})
        for a, b in zip(ours(PLACES), theirs, strict=True):
            np.testing.assert_array_equal(a, b)
    covariance = reference.kernel_(u[:, None]) + np.diag(variance)
    np.testing.assert_array_equal(process.kernel.of(u) + np.diag(variance), covariance)
    assert log_likelihood(covariance, y) == multivariate_normal.logpdf(y, cov=covariance)
