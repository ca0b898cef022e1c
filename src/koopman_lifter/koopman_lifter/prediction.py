"""Prediction error of a model, several steps ahead, in the coordinates of the state.

    x_hat(t + h Dt) = C K^h g(X(t)),   C picks the newest samples, monomials of degree one

Predicting the mean has an error of 1; the error of predicting "no change" stands beside it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from koopman_lifter.model import KoopmanModel

HORIZONS = (1, 10, 50, 200)  # steps ahead
BLOCK = 16384  # states lifted at a time


class Forecast:
    """Sums up errors over segments: states one dt apart.

    Parameters
    ----------
    model : KoopmanModel
        The model.
    horizons : sequence of int
        Steps ahead, each at least 1.
    """

    def __init__(self, model: KoopmanModel, horizons: tuple[int, ...] = HORIZONS) -> None:
        n = model.delays.channels
        self.model, self.horizons = model, horizons
        with np.errstate(over="ignore", invalid="ignore"):  # a mode may grow without bound
            self._maps = [np.linalg.matrix_power(model.K, steps)[1 : n + 1] for steps in horizons]
        self._errors = np.zeros((len(horizons), n))
        self._unchanged = np.zeros((len(horizons), n))
        self._counts = np.zeros(len(horizons), np.int64)
        self._sum, self._squares, self._states = np.zeros(n), np.zeros(n), 0

    def add(self, states: NDArray[np.float64], known: int) -> None:
        """Add a part of a segment.

        Parameters
        ----------
        states : ndarray, shape (channels, M)
            Samples one step apart.
        known : int
            How many of them, at the beginning, were in the part before.
        """
        delays = self.model.delays
        channels, states = delays.channels, delays.embed(states)
        known = max(known - (delays.depth - 1), 0)
        new = states[:channels, known:]
        self._sum += new.sum(axis=1)
        self._squares += (new**2).sum(axis=1)
        self._states += new.shape[1]
        for i, (steps, rows) in enumerate(zip(self.horizons, self._maps, strict=True)):
            for begin in range(max(steps, known), states.shape[1], BLOCK):
                after = states[:channels, begin : begin + BLOCK]
                before = states[:, begin - steps : begin - steps + after.shape[1]]
                with np.errstate(over="ignore", invalid="ignore"):
                    predicted = rows @ self.model.observables.lift(before)
                    self._errors[i] += ((predicted - after) ** 2).sum(axis=1)
                self._unchanged[i] += ((before[:channels] - after) ** 2).sum(axis=1)
                self._counts[i] += after.shape[1]

    def result(self) -> list[dict[str, Any]]:
        """Return root mean square errors over the standard deviation, one entry a horizon.

        A horizon that no segment is long enough for is left out.
        """
        if not self._states:
            return []
        mean = self._sum / self._states
        deviation = np.sqrt(np.maximum(self._squares / self._states - mean**2, 0.0))
        deviation[deviation == 0.0] = np.nan
        entries = []
        for i, steps in enumerate(self.horizons):
            if self._counts[i]:
                error = np.sqrt(self._errors[i] / self._counts[i]) / deviation
                unchanged = np.sqrt(self._unchanged[i] / self._counts[i]) / deviation
                entries.append(
                    {
                        "steps": steps,
                        "error": [float(f"{value:.4g}") for value in error],
                        "no_change": [float(f"{value:.4g}") for value in unchanged],
                        "predictions": int(self._counts[i]),
                    }
                )
        return entries
