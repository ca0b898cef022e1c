"""Surrogates, amplitudes, maps and findings of which the truth is an analytic function."""

import math

import numpy as np

from koop_identify.model.compare import Cost
from koop_tune.excitation.amplitude import Amplitude, Mode, Windows
from koop_tune.excitation.static_map import GRID, StaticMap
from koop_tune.rig.scale import Scale
from koop_tune.rig_model.dwells import Dwells, Rest
from koop_tune.rig_model.surrogate import Surrogate, Times
from koop_tune.search.findings import CostMaps, Findings
from koop_tune.search.limits import ThetaLimits
from koop_tune.search.run import Task
from koop_tune.search.settings import SearchSettings

DT, FREQUENCY = 0.02, 2.0


def make_amplitude(length=50, dt=DT, floor=1e-6):
    """Return the amplitude of one channel that sums all frequencies: 1 is a sine of amplitude 1."""
    windows = Windows(length, dt)
    weight = np.full((1, windows.frequency.size), 2.0)
    return Amplitude(windows, weight, 0.0, floor, weight)


def make_dwells(rests, logs, length=50, dt=DT, count=9):
    """Return rests at evenly spaced values of theta."""
    return Dwells(np.linspace(0.0, 1.0, count), rests, make_amplitude(length, dt), logs)


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
    return Task(fine, coarse, Scale(low, high), sense, time, DT, rate, low, high, settings)


def make_map(level, error=0.05, sense=1.0, u=None):
    """Return the map of a function of the position, with a hold at each of some positions."""
    u = np.linspace(0.0, 1.0, 9) if u is None else np.asarray(u, float)
    y = np.asarray(level(u), float) + 0.0 * u
    return StaticMap(u, y, np.full(u.size, error), sense)


def make_cost(name, level, error=0.05, near=0.1, sense=1.0, reference=None):
    """Return a cost with one map, or one that cannot be made.

    The amplitude's map is ``reference``, or that of the same function.
    """
    y_out = None if level is None else np.ones(10)
    maps = {} if level is None else {4.0: make_map(level, error, sense)}
    problem = "too few windows" if level is None else ""
    amplitude = make_map(reference or level or (lambda u: 0.0 * u), error, sense)
    return CostMaps(Cost(name, None, None, y_out, problem), maps, amplitude, near)


def make_findings(level, costs=(), error=0.05, wander=0.01, sense=1.0, scale=Scale(0.0, 1.0)):  # noqa: B008
    """Return what a recording of such a map shows."""
    logs = [np.random.default_rng(i).normal(0.0, wander, 100) for i in range(9)]
    rests = [Rest(i, 100 * i, 100 * (i + 1), 0) for i in range(9)]
    limits = ThetaLimits(scale.low, scale.high)
    return Findings(
        scale, make_dwells(rests, logs), make_map(level, error, sense), 1 / FREQUENCY, "x",
        list(costs), limits, [Mode("x at 2 Hz", 0, 1, 3, 1.0, 1.0)], frequency=2.014,
    )  # fmt: skip
