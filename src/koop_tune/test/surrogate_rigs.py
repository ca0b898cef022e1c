"""Surrogates of which the map is an analytic function."""

import math

import numpy as np

from koop_tune.excitation.static_map import GRID
from koop_tune.rig_model.surrogate import Surrogate, Times
from koop_tune.search.search import Task
from koop_tune.search.settings import SearchSettings

DT, FREQUENCY = 0.02, 2.0


def make_surrogate(level, tau=2.0, low=0.0, high=1.0, logarithmic=False, noise=0.0, every=0):
    """Return a rig of nine values whose levels are those of a function of the position.

    With ``every`` it is a coarse one, of blocks of so many samples.
    """
    rng = np.random.default_rng(0)
    u, grid = np.linspace(0.0, 1.0, 9), np.linspace(0.0, 1.0, GRID)
    t = np.arange(3000) * DT
    parts = []
    for v in u:
        y = np.sin(2 * np.pi * FREQUENCY * t + rng.uniform(0.0, 2 * np.pi))
        y += noise * rng.normal(size=t.size)
        if every:
            y = np.sqrt((y**2).reshape(-1, every).mean(axis=1))
        parts.append(math.exp(level(v)) * y)
    return Surrogate(
        np.asarray(level(grid)), np.asarray(level(grid)), u, np.asarray(level(u)),
        np.concatenate(parts), np.arange(10) * parts[0].size, np.arange(10),
        Times(math.log(tau), 0.0, 0.0, 0.0), DT * max(every, 1), low, high, logarithmic,
        every > 0,
    )  # fmt: skip


def make_task(level, rate=1e3, sense=1.0, settings=SearchSettings(), time=3.0, **of_rig):  # noqa: B008
    """Return the task of such a rig, with two corner frequencies."""
    omega = 2 * np.pi * FREQUENCY
    fine, coarse = (
        {factor * omega: [make_surrogate(level, every=every, **of_rig)] for factor in (1.0, 3.0)}
        for every in (0, 5)
    )
    low, high = of_rig.get("low", 0.0), of_rig.get("high", 1.0)
    return Task(fine, coarse, sense, time, DT, rate, low, high, settings)
