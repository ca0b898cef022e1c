"""A Gaussian process over one position, conditioned on values with errors of their own.

See Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006. The numbers are those of
scikit-learn's regressor to the last bit, in half the time: that one asks for the hyperparameters of
kernels of all kinds in each step of a fit, and takes half a second to import.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_solve, cholesky, eigh, solve_triangular
from scipy.optimize import minimize
from scipy.spatial.distance import cdist, pdist, squareform

Array = NDArray[np.float64]
LOG_2_PI = math.log(2.0 * math.pi)


@cache
def blas_threads() -> Any:
    """Return what limits the threads of BLAS; to find its libraries takes a tenth of a fit.

    They must have been imported.
    """
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")


class Kernel(NamedTuple):
    """Covariance of two values at a distance d: a Matern 3/2 (eq. 4.17) and white noise.

        k(d) = c (1 + s) exp(-s) + (w if it is one value else 0),   s = sqrt(3) d / l

    Attributes
    ----------
    constant : float
        Variance c.
    length : float
        Length scale l.
    white : float
        Variance w of the white noise.
    """

    constant: float
    length: float
    white: float

    def between(self, a: Array, b: Array) -> Array:
        """Return the covariance, shape (M, N), of values at positions (M,) and others at (N,)."""
        s = cdist(a[:, None] / self.length, b[:, None] / self.length) * math.sqrt(3.0)
        return np.asarray(self.constant * ((1.0 + s) * np.exp(-s)))

    def of(self, u: Array) -> Array:
        """Return the covariance, shape (N, N), of values at positions (N,)."""
        smooth = self.constant * self._matern(self._distances(u))
        return np.asarray(smooth + self.white * np.eye(u.size))

    def with_gradient(self, u: Array) -> tuple[Array, Array]:
        """Return also its derivatives by log c, log l and log w, shape (N, N, 3)."""
        d = self._distances(u)
        smooth, white = self.constant * self._matern(d), self.white * np.eye(u.size)
        squared = squareform(d**2)
        by_length = self.constant * (3.0 * squared * np.exp(-np.sqrt(3.0 * squared)))
        return smooth + white, np.stack([smooth, by_length, white], axis=2)

    def _distances(self, u: Array) -> Array:
        """Return d / l of all pairs."""
        return np.asarray(pdist(u[:, None] / self.length))

    def _matern(self, distances: Array) -> Array:
        s = distances * math.sqrt(3.0)
        matern = squareform((1.0 + s) * np.exp(-s))
        np.fill_diagonal(matern, 1.0)
        return np.asarray(matern)


def log_likelihood(covariance: Array, y: Array) -> float:
    """Return the logarithm of the likelihood of values of mean 0 (eq. 2.30)."""
    variances, directions = eigh(covariance)
    whitened = y[None] @ (directions * np.sqrt(1.0 / variances))
    volume = y.size * LOG_2_PI + np.log(variances).sum()
    return -0.5 * float(volume + np.square(whitened).sum())


class GaussianProcess:
    """The process with the kernel of the largest likelihood.

    Parameters
    ----------
    u : ndarray, shape (N,)
        Positions.
    y : ndarray, shape (N,)
        Values, about 0.
    variance : ndarray, shape (N,)
        Variance of each.
    start : Kernel
        With which the search begins; a second one begins at random.
    low, high : Kernel
        Between which it searches.
    """

    def __init__(
        self, u: Array, y: Array, variance: Array, start: Kernel, low: Kernel, high: Kernel
    ) -> None:
        self._u, self._y, self._variance = u, y, variance
        bounds = np.log([low, high])
        begins = np.log(start), np.random.RandomState(0).uniform(*bounds)
        # threads only wait for each other over matrices as small as these: five times the time
        with blas_threads().limit(limits=1):
            found = [
                minimize(self._cost, begin, method="L-BFGS-B", jac=True, bounds=bounds.T)
                for begin in begins
            ]
        self.kernel = _kernel(min(found, key=lambda each: float(each.fun)).x)
        covariance = self.kernel.of(u)
        np.fill_diagonal(covariance, covariance.diagonal() + variance)
        self._root = cholesky(covariance, lower=True, check_finite=False)
        self._weights = cho_solve((self._root, True), y, check_finite=False)

    def _cost(self, logs: Array) -> tuple[float, Array]:
        """Return less the log likelihood, and its gradient (algorithm 2.1, eq. 5.9)."""
        covariance, gradient = _kernel(logs).with_gradient(self._u)
        np.fill_diagonal(covariance, covariance.diagonal() + self._variance)
        try:
            root = cholesky(covariance, lower=True, check_finite=False)
        except LinAlgError:
            return math.inf, np.zeros_like(logs)
        y = self._y[:, None]
        weights = cho_solve((root, True), y, check_finite=False)
        likelihood = -0.5 * np.einsum("ik,ik->k", y, weights)
        likelihood -= np.log(np.diag(root)).sum()
        likelihood -= y.size / 2.0 * LOG_2_PI
        inverse = cho_solve((root, True), np.eye(y.size), check_finite=False)
        inner = np.einsum("ik,jk->ijk", weights, weights) - inverse[..., None]
        slope = 0.5 * np.einsum("ijl,jik->kl", inner, gradient)
        return -float(likelihood.sum()), -slope.sum(axis=-1)

    def predict(self, u: Array) -> tuple[Array, Array]:
        """Return mean and standard deviation of values at positions, shape (M,)."""
        y, solved = self._solve(u)
        alone = self.kernel.constant + self.kernel.white
        variance = alone - np.einsum("ij,ji->i", solved.T, solved)
        return y, np.sqrt(np.maximum(variance, 0.0))

    def predict_together(self, u: Array) -> tuple[Array, Array]:
        """Return the mean of values at positions, shape (M,), and their covariance (M, M)."""
        y, solved = self._solve(u)
        return y, self.kernel.of(u) - solved.T @ solved

    def _solve(self, u: Array) -> tuple[Array, Array]:
        """Return the mean at positions, shape (M,), and what the values tell of it, (N, M)."""
        across = self.kernel.between(u, self._u)
        return across @ self._weights, solve_triangular(
            self._root, across.T, lower=True, check_finite=False
        )


def _kernel(logs: Array) -> Kernel:
    """Return the kernel of which these are the logarithms."""
    return Kernel(*np.exp(logs))
