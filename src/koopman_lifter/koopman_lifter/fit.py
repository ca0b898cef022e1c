"""How a model is made from the sums over the data; the defaults are the paper's."""

from __future__ import annotations

from dataclasses import dataclass

from koop_core.config.parameter import parameter, validate
from koopman_lifter.estimators import ESTIMATORS
from koopman_lifter.modes import SELECTIONS


@dataclass(frozen=True)
class Fit:
    """From the sums to K and its dominant modes."""

    estimator: str = parameter("least-squares", "estimate of K", choices=tuple(ESTIMATORS))
    select: str = parameter("energy", "what the kept modes have", choices=SELECTIONS)
    residual_limit: float = parameter(
        0.2, "largest residual of a mode that 'trusted' keeps", low=0.0, high=10.0
    )
    resamples: int = parameter(
        0, "data sets drawn for the spread of the eigenvalues; 0: no spread", low=0, high=10_000
    )

    def __post_init__(self) -> None:
        validate(self)
