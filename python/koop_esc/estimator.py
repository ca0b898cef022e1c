"""Extended dynamic mode decomposition as an estimator of scikit-learn."""

from __future__ import annotations

import math
from operator import index
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import _check_feature_names_in, check_is_fitted, validate_data

from koop_core.errors import InputError
from koopman_lifter.edmd import Gram
from koopman_lifter.model import LONGEST, KoopmanModel, build
from koopman_lifter.observables import Monomials


class EDMD(TransformerMixin, BaseEstimator):  # type: ignore[misc]
    """Koopman model z_{k+1} = K z_k of the monomials z = g(x) of a state (Williams et al. 2015).

    Parameters
    ----------
    degree : int
        Largest degree of the monomials.
    modes : int
        N, dominant modes that the cost sums up; one more where N would split a complex pair.
    dt : float
        Time between two states [s].

    Attributes
    ----------
    model_ : KoopmanModel
        What :class:`~koop_esc.online.Cost` takes and ``koop train`` writes: ``model_.save(path)``.
    eigenvalues_ : ndarray of complex, shape (p,)
        Eigenvalues of K, the slowest to decay first; of a mode of frequency f [Hz] the angle is
        2 pi f dt, and ``model_.energies`` says how strong it is.
    n_features_in_ : int
        Number n of components of the state.
    feature_names_in_ : ndarray of str, shape (n,)
        Their names, where the state has them: a DataFrame. Else they are x0, x1 and so on.

    Examples
    --------
    >>> k = np.arange(400)
    >>> x = 0.999 ** k[:, None] * np.c_[np.cos(0.1 * k), np.sin(0.1 * k)]  # a decaying oscillation
    >>> model = EDMD(degree=1, modes=2, dt=0.01).fit(x)
    >>> float(np.abs(np.angle(model.eigenvalues_)).max().round(9))
    0.1
    >>> bool(np.allclose(model.predict(x[:1]), x[1:2]))
    True
    """

    def __init__(self, degree: int = 3, modes: int = 8, dt: float = 1.0) -> None:
        self.degree, self.modes, self.dt = degree, modes, dt

    def fit(self, X: ArrayLike, y: object = None) -> EDMD:
        """Identify the model from the states of one trajectory, shape (M, n), dt apart.

        Raises
        ------
        ValueError
            If a value is not finite, or the data cannot determine K: too few or too alike.
        """
        self.__dict__.pop("_gram", None)
        return self.partial_fit(X)

    def partial_fit(self, X: ArrayLike, y: object = None) -> EDMD:
        """Add another trajectory, shape (M, n), and identify the model from all of them."""
        first = not hasattr(self, "_gram")
        states = validate_data(self, X, dtype=np.float64, reset=first, ensure_min_samples=2)
        if not 0.0 < self.dt < LONGEST:
            raise InputError(f"dt = {self.dt:g}: must be above 0 and below {LONGEST:g} s")
        if first:
            samples, n = states.shape
            degree = index(self.degree)  # of NumPy's integers no model file is written
            if (p := math.comb(n + degree, n)) >= samples:  # before there is room for them
                raise InputError(
                    f"{samples} samples (rows) of {n} channels (columns) cannot determine {p} "
                    "observables: transpose the array, record for longer or lower the degree"
                )
            self._gram = Gram.empty(Monomials(n, degree))
        self._gram.add_trajectory(states.T)
        names = tuple(_check_feature_names_in(self))
        self.model_: KoopmanModel = build(self._gram, self.dt, names, index(self.modes), {})
        self.eigenvalues_ = self.model_.eigenvalues
        return self

    def transform(self, X: ArrayLike) -> NDArray[np.float64]:
        """Lift states, shape (M, n), to their observables, shape (M, p)."""
        states = self._check(X)
        return self.model_.observables.lift(states.T).T

    def predict(self, X: ArrayLike) -> NDArray[np.float64]:
        """Return the next state of each of the states, both of shape (M, n)."""
        ahead = self.transform(X) @ self.model_.K.T
        return np.asarray(ahead[:, 1 : self.n_features_in_ + 1])

    def get_feature_names_out(self, input_features: ArrayLike | None = None) -> NDArray[Any]:
        """Return the observables in words, for example ``x0^2*x1``, shape (p,)."""
        check_is_fitted(self)
        names = tuple(_check_feature_names_in(self, input_features))
        return np.array(self.model_.observables.names(names), dtype=object)

    def _check(self, X: ArrayLike) -> NDArray[np.float64]:
        check_is_fitted(self)
        return np.asarray(validate_data(self, X, dtype=np.float64, reset=False))
