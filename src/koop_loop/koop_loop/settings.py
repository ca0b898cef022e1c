"""Settings of the metrics of a run."""

from __future__ import annotations

from dataclasses import dataclass

from koop_core.config.parameter import Settings, judged, parameter


@dataclass(frozen=True)
class MetricsSettings(Settings):
    """When theta has converged or settled, and where amplitudes are taken."""

    tolerance: float = parameter(
        0.1, "|theta - theta*| that counts as reached", low=0.0,
        origin="judgement; the paper gives none",
    )  # fmt: skip
    converged: float = parameter(
        0.6, "mean |theta - theta*| of a converged tail", low=0.0,
        origin="twice the mean of the relay's limit cycle",
    )  # fmt: skip
    tail: float = parameter(
        0.3, "share of a run that is steady state", low=0.0, high=1.0, origin="the paper"
    )
    periods: float = judged(
        5.0, "length of a window, in periods of the strongest oscillation", low=1.0
    )
    least: float = judged(0.04, "least share of the run in a window", low=0.0, high=1.0)
    most: float = judged(0.2, "largest share", low=0.0, high=1.0)
    shortest: int = judged(8, "samples of a window", low=2)
    widened: float = judged(0.1, "share by which the final swing is widened at both ends", low=0.0)
    rest: float = judged(
        0.2, "share of the tail for which theta was in its final swing before", low=0.0
    )
    without_drift: float = judged(
        200.0, "time over which r* is averaged if the damping does not drift", unit="s", low=1.0
    )


METRICS = MetricsSettings()
