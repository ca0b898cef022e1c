"""Static maps by which others have measured extremum seeking with several inputs.

One rule for all: a dwell time of four samples, steps of 1 % of the inputs' range. Nothing else is
known of a map, and a sample is an evaluation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import direct
from koop_core.stream.arrival import Arrival
from koop_study.simulation.knobs import signs
from relay_esc import directions
from relay_esc.config import EscConfig

Array = NDArray[np.float64]
DWELL, STEP = 4.0, 0.01  # [samples], ranges per sample
LONGEST = 4000  # samples of a run
NO = (False, False)  # the cost is of the same quantity as before, and has settled
HESSIAN = np.array([[100.0, 30.0], [30.0, 20.0]])


@dataclass(frozen=True)
class Yardstick:
    """A map, where it is begun, and when it counts as reached."""

    cost: Callable[[Array], float]
    """Of the inputs, shape (n,); above 0."""
    start: Array
    best: Array
    """Shape (n,): inputs at first, and the optimum; the start lies in a random direction where
    ``turned``."""
    low: float
    high: float
    """Limits of each input."""
    reached: Callable[[Array], bool]
    """Whether the inputs are near enough."""
    turned: bool = True
    """Whether the source's figure holds for every start at that distance."""
    objective: str = "minimise"
    """As in :class:`relay_esc.config.EscConfig`."""


def farm_power(u: Array) -> float:
    """Return the power [MW] of two rows of three turbines of induction u, shape (6,), at 8 m/s.

    Diameter 80 m, 400 m apart; in a row each wake, of expansion 0.075, takes a share of the speed
    (Jensen 1983), and the shares add up: P = rho/2 A 4 u (1 - u)^2 V^3 with rho = 1.225 kg/m^3.
    """
    place, power = 400.0 * np.arange(3), 0.0
    for row in u.reshape(2, 3):
        for i in range(3):
            wakes = 2.0 * row[:i] * (80.0 / (80.0 + 0.15 * (place[i] - place[:i]))) ** 2
            speed = 8.0 * (1.0 - wakes.sum())
            power += 0.5 * 1.225 * np.pi * 40.0**2 * 4.0 * row[i] * (1.0 - row[i]) ** 2 * speed**3
    return 1e-6 * float(power)


def _quadratic(direction: int) -> Yardstick:
    """Return Ghaffari's quadratic, begun along an eigenvector of its Hessian."""
    best, vector = np.array([2.0, 4.0]), np.linalg.eigh(HESSIAN)[1][:, direction]
    first = np.hypot(0.5, 1.0)
    return Yardstick(
        lambda u: 100.0 + 0.5 * float((u - best) @ HESSIAN @ (u - best)),
        best + first * vector, best, 0.0, 8.0,
        lambda u: bool(np.linalg.norm(u - best) < first / np.e), turned=False,
    )  # fmt: skip


FARM = np.tile([0.2145, 0.2119, 0.3333], 2)
YARDSTICKS = {
    "mean square": Yardstick(
        lambda u: float(np.mean(u**2)), np.array([0.2, 0.2]), np.zeros(2), -1.0, 1.0,
        lambda u: bool(np.mean(u**2) <= 1e-3),
    ),
    "quadratic, flat": _quadratic(0),
    "quadratic, steep": _quadratic(1),
    "wind farm": Yardstick(
        farm_power, np.full(6, 0.3), FARM, 0.1, 0.5,
        lambda u: farm_power(u) >= 0.999 * farm_power(FARM), turned=False, objective="maximise",
    ),
}  # fmt: skip


def seek_yardstick(name: str, seeds: list[int]) -> list[dict[str, Any]]:
    """Seek on a map from both signs of each input.

    Each row has the samples until it is reached, None if never, what the cost is at the end, and
    how far an input has travelled until then, in ranges.
    """
    map_, rows = YARDSTICKS[name], []
    n, width = map_.start.size, map_.high - map_.low
    limits: dict[str, Any] = {
        "theta_min": (map_.low,) * n, "theta_max": (map_.high,) * n,
        "theta_initial": (map_.low,) * n,
    }  # fmt: skip
    esc = EscConfig(
        law="adaptive", objective=map_.objective, dwell=DWELL, tau_f=DWELL, step_size=STEP * width,
        **limits,
    )  # fmt: skip
    fixed = esc.knob(0).params(1.0), esc.knob_limits(1.0)
    first = esc.initial_directions()  # whose arrays are changed
    answer = direct(directions.answer, *fixed, first, int(Arrival.RESTART), *NO, 0.0, False)
    for seed in seeds:
        rng = np.random.default_rng(seed)
        u = map_.start
        if map_.turned:
            way = rng.standard_normal(n)
            u = map_.best + np.linalg.norm(u - map_.best) * way / np.linalg.norm(way)
        state = directions.start(u, signs(n, rng), u, u)
        path = np.empty((LONGEST, n))
        for k in range(LONGEST):
            path[k] = state.theta
            arrival = int(Arrival.NEXT if k else Arrival.RESTART)
            state, _, _ = answer(*fixed, state, arrival, *NO, map_.cost(path[k]), False)
        reached = [map_.reached(u) for u in path]
        count = reached.index(True) if any(reached) else None
        travel = np.abs(np.diff(path[:count], axis=0)).sum(axis=0).mean() / width
        tail = np.mean([map_.cost(u) for u in path[-LONGEST // 4 :]])
        rows.append({"samples": count, "cost": float(tail), "travel": float(travel)})
    return rows
