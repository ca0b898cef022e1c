"""Loops with several knobs: random rigs, and the paper's plant with n knobs in theta's place.

Both see e = M (u - u*) of the knobs u, where u* is the optimum and M = S R: a rotation R, so that
the knobs are coupled, and a diagonal S from 1 down to ``condition``^-1/2, so that they are of
unequal worth. The paper's plant has |e|^2 in the place of its (theta - theta*)^2.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import njit
from koop_core.stream.arrival import Arrival
from koop_study.simulation.case import case_of
from koop_study.simulation.run import run
from relay_esc import directions
from relay_esc.config import EscConfig
from relay_esc.directions import DirectionState, Knobs, start
from relay_esc.relay import RelayParams
from vdp_plant.dynamics import distance

Array = NDArray[np.float64]
DT = 1.0 / 20.0  # [periods of a random rig] between two samples
DWELL = 20.0  # [periods] of its controller
GAIN = 0.1  # growth of its amplitude per sample where |e| = 1
BEST = 0.07  # |e| that its best amplitude is worth
NOISE = 0.05  # of ln r, correlated over a period
LAG = 3.0  # [periods] of its amplitude detector
TAIL = 0.3  # share of a run that counts at its end


@njit()
def seek_on_map(
    p: RelayParams, k: Knobs, m: Array, u_star: Array, state: DirectionState,
    rng: np.random.Generator, way: Array,
) -> None:  # fmt: skip
    """Run a loop on a limit cycle of amplitude a, da = a (GAIN (|e|^2 + BEST^2) - a^2) a sample."""
    lag, kept = math.exp(-DT / LAG), math.exp(-DT)
    a, r, noise = 0.0, 0.0, 0.0
    for i in range(way.size):
        way[i] = distance(m, state.output, u_star)
        growth = GAIN * (way[i] ** 2 + BEST * BEST)
        a = math.sqrt(growth) if i == 0 else a + a * (growth - a * a)
        noise = kept * noise + math.sqrt(1.0 - kept * kept) * rng.standard_normal()
        r = lag * r + (1.0 - lag) * a * a * math.exp(NOISE * noise)
        arrival = Arrival.RESTART if i == 0 else Arrival.NEXT
        state, _, _ = directions.answer(p, k, state, arrival, False, False, r, False)


def rotation(n: int, rng: np.random.Generator) -> Array:
    """Return a random rotation, shape (n, n)."""
    q, r = np.linalg.qr(rng.standard_normal((n, n)))
    return np.asarray(q * np.sign(np.diag(r)))


def coupling(n: int, condition: float, rng: np.random.Generator) -> Array:
    """Return M, shape (n, n)."""
    return np.diag(np.geomspace(1.0, condition**-0.5, n)) @ rotation(n, rng)


def signs(n: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return the relay sign that each knob begins with, shape (n,)."""
    return rng.choice(np.array([-1, 1]), n)


def knobs_of_map(
    n: int, condition: float, useless: bool, seeds: list[int], duration: float
) -> list[dict[str, Any]]:
    """Run random rigs with knobs from -1 to 1 for a ``duration`` in dwell times.

    The optimum is in the inner 70 %, the start in the inner 90 %. ``useless``: one knob does
    nothing. Each row has the mean amplitude at the end over the best one, and the dwell times until
    a dwell time's mean is within 1.5 of the best; None: it never is.
    """
    samples = round(DWELL / DT)
    esc = EscConfig(
        law="adaptive", dwell=DWELL, tau_f=DWELL / 2.5, step_size=0.1 / samples, theta_min=-1.0,
        theta_max=1.0, theta_initial=0.0,
    )  # fmt: skip
    ones, rows = np.ones(n), []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        m = coupling(n, condition, rng)
        if useless:
            m[:, rng.integers(n)] = 0.0
        u_star, u = rng.uniform(-0.7, 0.7, n), rng.uniform(-0.9, 0.9, n)
        way = np.empty(round(duration * samples))
        knobs = Knobs(-ones, ones, ones, np.full(n, math.inf), -ones, ones)
        state = start(u, signs(n, rng), u, u)
        seek_on_map(esc.params(DT), knobs, m, u_star, state, rng, way)
        ratio = np.hypot(way, BEST) / BEST
        within = ratio[: ratio.size // samples * samples].reshape(-1, samples).mean(axis=1) < 1.5
        rows.append({
            "amplitude": float(ratio[-round(TAIL * ratio.size):].mean()),
            "arrival": int(np.argmax(within)) if within.any() else None,
        })  # fmt: skip
    return rows


def knobs_of_plant(n: int, settings: dict[str, Any], seeds: list[int]) -> list[dict[str, Any]]:
    """Run the paper's plant with n rotated knobs, 5 from the optimum at first as in the paper.

    Each row has the integral of |e| over the time, and its mean at the end.
    """
    rows = []
    for seed in seeds:
        case, rng = case_of(settings, seed), np.random.default_rng(seed)
        m, u = rotation(n, rng), np.zeros(n)
        far = rng.standard_normal(n)
        u_star = np.linalg.solve(m, 5.0 * far / np.linalg.norm(far))
        initial = each(u)
        coupling = tuple(m.ravel()) if n > 1 else ()
        plant = {"theta_initial": initial, "theta_star": each(u_star), "coupling": coupling}
        esc = {
            "theta_initial": initial,
            "theta_min": each(np.minimum(u, u_star) - 3.0),
            "theta_max": each(np.maximum(u, u_star) + 3.0),
        }
        done = run(replace(case, plant=replace(case.plant, **plant), esc=replace(case.esc, **esc)))
        way = np.linalg.norm((done.theta.reshape(-1, n) - u_star) @ m.T, axis=1)
        rows.append({
            "iae": float(way.sum() * case.plant.dt),
            "distance": float(way[-round(TAIL * way.size):].mean()),
        })  # fmt: skip
    return rows


def each(values: NDArray[Any]) -> Any:
    """Return a parameter of each knob: one number of a single knob."""
    return tuple(values) if values.size > 1 else float(values[0])
