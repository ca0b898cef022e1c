"""Monomial observables g(x) of an n-dimensional state.

For n = 2 and degree 3 the order is the paper's (section 3.2):
z = [1, x, y, x^2, x y, y^2, x^3, x^2 y, x y^2, y^3].
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koop_core.kernels import njit


@dataclass(frozen=True)
class Monomials:
    """All monomials of ``n`` variables up to ``degree``, by degree, then lexicographically.

    Every monomial but the first, 1, is an earlier one times one variable, so that lifting a state
    costs p - 1 multiplications: ``z[i] = z[parent[i]] * x[factor[i]]``.
    """

    n: int
    """Dimension of the state, at least 1."""
    degree: int
    """Largest total degree, at least 1."""

    def __post_init__(self) -> None:
        if self.n < 1 or self.degree < 1:
            raise ValueError(f"monomials need n >= 1 and degree >= 1, got {self.n}, {self.degree}")

    @cached_property
    def _products(self) -> list[tuple[int, ...]]:
        return [
            product
            for degree in range(self.degree + 1)
            for product in combinations_with_replacement(range(self.n), degree)
        ]

    @property
    def p(self) -> int:
        """Number of observables."""
        return len(self._products)

    @cached_property
    def parent(self) -> NDArray[np.int64]:
        """Index of the monomial that each one extends, shape (p,); 0 for the first."""
        position = {product: i for i, product in enumerate(self._products)}
        return np.array([position[product[:-1]] for product in self._products], dtype=np.int64)

    @cached_property
    def factor(self) -> NDArray[np.int64]:
        """Index of the variable that each monomial's parent is multiplied by, shape (p,)."""
        return np.array(
            [product[-1] if product else 0 for product in self._products], dtype=np.int64
        )

    @property
    def exponents(self) -> NDArray[np.int64]:
        """Exponent of each variable in each monomial, shape (p, n)."""
        rows = [[product.count(j) for j in range(self.n)] for product in self._products]
        return np.array(rows, dtype=np.int64)

    def names(self, state_names: tuple[str, ...]) -> list[str]:
        """Return the monomials in words, for example ``x^2*y``; shape (p,)."""
        return [
            "*".join(
                name if power == 1 else f"{name}^{power}"
                for name, power in zip(state_names, row, strict=True)
                if power
            )
            or "1"
            for row in self.exponents
        ]

    def lift(
        self, states: ArrayLike, out: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """Lift states.

        Parameters
        ----------
        states : array_like, shape (n,) or (n, M)
            One state or M of them as columns.
        out : ndarray, shape (p,) or (p, M), optional
            Where to write the observables.

        Returns
        -------
        ndarray, shape (p,) or (p, M)
            Observables, one column a state.

        Raises
        ------
        ValueError
            If the first dimension is not n.
        """
        array = np.asarray(states, dtype=np.float64)
        if array.ndim not in (1, 2) or array.shape[0] != self.n:
            raise ValueError(
                f"states must have shape ({self.n},) or ({self.n}, M), got {array.shape}"
            )
        lifted = np.empty((self.p, *array.shape[1:])) if out is None else out
        lifted[0] = 1.0
        for i, (parent, factor) in enumerate(zip(self.parent, self.factor, strict=True)):
            if i:
                np.multiply(lifted[parent], array[factor], out=lifted[i, ...])
        return lifted


@njit(inline="always")  # see koopman_lifter.cost
def lift_into(
    parent: NDArray[np.int64],
    factor: NDArray[np.int64],
    x: NDArray[np.float64],
    z: NDArray[np.float64],
) -> None:
    """Write g(x) into ``z``, shape (p,), for one state ``x``, shape (n,)."""
    z[0] = 1.0
    for i in range(1, z.shape[0]):
        z[i] = z[parent[i]] * x[factor[i]]
