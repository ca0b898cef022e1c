"""What a tuned loop will do: figures with their bands."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

PERCENTILES = (5.0, 50.0, 95.0)


@dataclass(frozen=True)
class Band:
    """A figure with its band: 5 %, median and 95 % of the runs; infinite is never."""

    low: float
    middle: float
    high: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Band:
        """Return the band of values."""
        low, middle, high = np.percentile(values, PERCENTILES, method="nearest")
        return cls(float(low), float(middle), float(high))

    @classmethod
    def from_json(cls, values: Mapping[str, float | None]) -> Band:
        """Return the band in a JSON object; null is infinite.

        >>> Band.from_json({"low": 1.0, "middle": 2.0, "high": None}).as_json()
        {'low': 1.0, 'middle': 2.0, 'high': None}
        """
        low, middle, high = (values[name] for name in ("low", "middle", "high"))
        return cls(*(math.inf if value is None else float(value) for value in (low, middle, high)))

    def as_json(self) -> dict[str, float | None]:
        """Return it in JSON terms."""
        return {name: v if math.isfinite(v) else None for name, v in asdict(self).items()}

    def as_text(self, unit: float = 1.0) -> str:
        """Return it in words, in units of ``1 / unit``.

        >>> Band(10.0, 20.0, math.inf).as_text()
        '20 (10 to never)'
        """
        low, middle, high = (
            "never" if math.isinf(value) else f"{unit * value:.3g}"
            for value in (self.low, self.middle, self.high)
        )
        return f"{middle} ({low} to {high})"


@dataclass(frozen=True)
class Prediction:
    """What the loop will do from either end of theta's range.

    Attributes
    ----------
    converges : Band
        Time until the amplitude is near its best [s].
    distance : Band
        Mean distance of theta from the best [u] once it has.
    excess : Band
        Amplitude then over the best one (its inverse where it is to be large).
    reduction : Band
        Amplitude at the start over the amplitude then (its inverse), from the worse end.
    duration : float
        Length of a run [s]; the second half counts as converged.
    runs : int
        Number of runs.
    """

    converges: Band
    distance: Band
    excess: Band
    reduction: Band
    duration: float
    runs: int

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Prediction:
        """Return the prediction in a JSON object."""
        bands = {name: Band.from_json(values[name]) for name in BANDS}
        return cls(**bands, duration=float(values["duration"]), runs=int(values["runs"]))

    def as_json(self) -> dict[str, Any]:
        """Return it in JSON terms."""
        bands = {name: getattr(self, name).as_json() for name in BANDS}
        return {"duration": self.duration, "runs": self.runs, **bands}


BANDS = ("converges", "distance", "excess", "reduction")
