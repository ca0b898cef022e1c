"""The laws by name, with the ranges that each is tuned in.

Times are in units of a plant's own: its slowest amplitude time plus two periods, which a step of
theta shows; corner frequencies of the detector in units of the oscillation's and of that time. So
one set of constants means the same on every rig. Ranges are logarithmic.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from koop_study.laws import loop

Range = tuple[float, float]
Constants = dict[str, float]
DETECTOR: dict[str, Range] = {"omega_h": (1.0, 100.0), "omega_l": (0.5, 10.0)}
SWEEPS: dict[str, Range] = {"amplitude": (0.01, 0.1), "period": (3.0, 30.0)}  # of a dither


@dataclass(frozen=True)
class LawSpec:
    """A law.

    Attributes
    ----------
    title : str
        Of its row.
    ranges : dict of str to Range
        Of its own constants.
    kind : int
        Of :mod:`koop_study.laws.loop`; HOLD where another program decides between two steps.
    pack : callable
        From constants and the plant's time [s] to the kernel's ``p``.
    """

    title: str
    ranges: dict[str, Range]
    kind: int
    pack: Callable[[Constants, float], list[float]]

    @property
    def searched(self) -> dict[str, Range]:
        """Every range that a tuning trial draws from; none where there is nothing to tune."""
        return {**DETECTOR, **self.ranges} if self.ranges else {}


def trials(law: str, count: int) -> list[Constants]:
    """Return the constants that a tuning tries: a Sobol sequence in the law's ranges."""
    ranges = LAWS[law].searched
    if not ranges:
        return [{}]
    from scipy.stats import qmc  # slow to import

    points = qmc.Sobol(len(ranges), seed=0).random(count)
    found = []
    for point in points:
        exponents = zip(ranges.items(), point, strict=True)
        found.append({n: float(low * (high / low) ** x) for (n, (low, high)), x in exponents})
    return found


def _perturbation(c: Constants, time: float) -> list[float]:
    omega = 2.0 * math.pi / (c["period"] * time)
    # a mean gradient of amplitude / 2 is what the demodulation sees
    gain = 2.0 * c["gain"] / (c["amplitude"] * time)
    return [c["amplitude"], omega, gain, 0.5 * omega, c["omega_g"] * omega]


def _newton(c: Constants, time: float) -> list[float]:
    omega = 2.0 * math.pi / (c["period"] * time)
    omega_g = c["omega_g"] * omega
    return [c["amplitude"], omega, c["gain"] / time, 0.5 * omega, omega_g, omega_g]


def _least_squares(c: Constants, time: float) -> list[float]:
    omega = 2.0 * math.pi / (c["period"] * time)
    return [c["amplitude"], omega, c["gain"] / time, c["forgetting"] * omega]


def _bounded(c: Constants, time: float) -> list[float]:
    omega = 2.0 * math.pi / (c["period"] * time)
    # sqrt(alpha / omega) is the dither, k alpha / 2 the gain of the average
    alpha = c["amplitude"] ** 2 * omega
    return [alpha, omega, 2.0 * c["gain"] / (time * alpha)]


def _sliding(c: Constants, time: float) -> list[float]:
    return [c["speed"] / time, c["rho"] / time, c["beta"]]


def _stochastic(c: Constants, time: float) -> list[float]:
    return [c["step"], c["interval"] * time, c["seed"]]


def _golden(c: Constants, time: float) -> list[float]:
    return [c["hold"] * time, c["resolution"]]


def _nothing(c: Constants, time: float) -> list[float]:
    return []


SEEKING: dict[str, Range] = {"speed": (0.005, 0.2), "dwell": (0.5, 8.0), "tau_f": (0.3, 5.0)}
LAWS: dict[str, LawSpec] = {
    "relay": LawSpec("relay (Salsbury 2023)", SEEKING, loop.RELAY, _nothing),
    "adaptive": LawSpec(
        "adaptive (the law of this project)",
        {**SEEKING, "step_ratio": (0.03, 0.3), "lost": (4.0, 16.0)},
        loop.RELAY,
        _nothing,
    ),
    "perturbation": LawSpec(
        "sinusoidal perturbation (Krstic, Wang 2000)",
        {**SWEEPS, "gain": (3e-4, 0.1), "omega_g": (0.1, 2.0)},
        loop.PERTURBATION,
        _perturbation,
    ),
    "newton": LawSpec(
        "Newton-like (Moase 2010; Ghaffari 2012)",
        {**SWEEPS, "gain": (3e-3, 0.3), "omega_g": (0.05, 1.0)},
        loop.NEWTON,
        _newton,
    ),
    "least_squares": LawSpec(
        "least-squares gradient (Guay, Dochain 2015)",
        {**SWEEPS, "gain": (3e-4, 0.1), "forgetting": (0.05, 1.0)},
        loop.LEAST_SQUARES,
        _least_squares,
    ),
    "bounded": LawSpec(
        "bounded ES (Scheinker, Krstic 2014)",
        {**SWEEPS, "gain": (3e-4, 0.1)},
        loop.BOUNDED,
        _bounded,
    ),
    "sliding": LawSpec(
        "sliding mode, periodic switching (Haskara 2000; Pan 2003)",
        {"speed": (0.005, 0.2), "rho": (0.01, 1.0), "beta": (0.05, 2.0)},
        loop.SLIDING,
        _sliding,
    ),
    "stochastic": LawSpec(
        "stochastic relay (Salsbury, Yu 2025; our reading)",
        {"step": (0.005, 0.1), "interval": (1.0, 8.0)},
        loop.STOCHASTIC,
        _stochastic,
    ),
    "golden": LawSpec(
        "golden section (Kiefer 1953)",
        {"hold": (2.0, 8.0), "resolution": (0.01, 0.1)},
        loop.GOLDEN,
        _golden,
    ),
    "optuna": LawSpec(
        "Bayesian optimisation (Optuna's TPE), then rest",
        {"hold": (1.5, 6.0), "points": (8.0, 30.0)},
        loop.HOLD,
        _nothing,
    ),
    "cern": LawSpec(
        "CERN's extremum-seeking package (GPL, its own API)",
        {
            "hold": (0.3, 3.0),
            "gain": (0.3, 30.0),
            "amplitude": (0.01, 0.1),
            "sampling": (5.0, 20.0),
        },
        loop.HOLD,
        _nothing,
    ),
    "oracle": LawSpec("oracle: the best fixed θ", {}, loop.HOLD, _nothing),
}
