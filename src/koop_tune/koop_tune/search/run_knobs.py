"""Runs of a loop with several knobs: the controller along its directions, on surrogates.

Their rig is that of the section which shows the optimum best, over how far all knobs are from the
best, |B (v - v*)|, B that of the bowl between them (:mod:`koop_tune.excitation.bowl`). The longer
side of the section tells levels and amplitudes; beyond its end they rise as the bowl does.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_tune.excitation.bowl import Bowl
from koop_tune.excitation.static_map import GRID
from koop_tune.rig.rig_file import RigFile
from koop_tune.rig.scale import Scale
from koop_tune.rig_model.surrogate import BLOCKS, KnobsBowl, run_knobs
from koop_tune.search.run import Constants, Outcome, Task, judge_run, make_lifter
from relay_esc.config import EscConfig

Array = NDArray[np.float64]


@dataclass(frozen=True)
class KnobsTask:
    """A rig with several knobs and its controller.

    Attributes
    ----------
    task : Task
        Its surrogates, over how far all knobs are from the best; the farthest corner is 1.
    bowl : KnobsBowl
        How far they are.
    starts : sequence of tuple of float
        Thetas at which the rig has settled when a loop is closed.
    speed : ndarray, shape (n,)
        Of the optimum's motion [ranges/s].
    """

    task: Task
    bowl: KnobsBowl
    starts: Sequence[tuple[float, ...]]
    speed: Array

    def try_out(self, esc: EscConfig, c: Constants, number: int, seed: int) -> Outcome:
        """Run once; ``number`` chooses surrogate and start, as of one knob."""
        task, bowl, dt = self.task, self.bowl, self.task.dt
        options = task.surrogates[c.omega_h]
        s = options[(number // 2) % len(options)]
        rng = np.random.default_rng([seed, number])
        start: Any = self.starts[number % 2]
        scales = list(map(Scale, bowl.low, bowl.high))
        at, low, high = (
            np.array([scale.u(np.array(v)) for scale, v in zip(scales, theta, strict=True)])
            for theta in (start, esc.each("theta_min"), esc.each("theta_max"))
        )
        limits = np.minimum(task.settings.drift, 0.5 * (high - low))
        drift = np.zeros(at.size) if number % 4 < 2 else rng.uniform(-limits, limits) / task.steps
        esc, far = replace(esc, theta_initial=start), bowl.distance(at)
        away, power = np.empty((at.size, BLOCKS)), np.empty(BLOCKS)
        run_knobs(
            s, bowl, make_lifter(task, c).detector_params(), esc.knob(0).params(dt),
            esc.knob_limits(dt), esc.initial_directions(), task.steps, drift + self.speed * dt, far,
            rng.random(1021), away, power,
        )  # fmt: skip
        outcome = judge_run(task, s, away[0], power, task.steps * dt, far)
        return replace(outcome, distance=float(away[:, BLOCKS // 2 :].mean(axis=1).max()))


def make_knobs_task(
    task: Task, rig: RigFile, knob: int, part: Scale, best: Array, bowl: Bowl,
    effective: Sequence[int], starts: Sequence[tuple[float, ...]],
) -> KnobsTask:  # fmt: skip
    """Return the rig of a section, and all knobs' way from the best.

    Parameters
    ----------
    task : Task
        That of the section.
    rig : RigFile
        The rig, with n knobs.
    knob, part : int and Scale
        Knob of the section, and the range that it has there.
    best : ndarray, shape (n,)
        Position of each knob at the best.
    bowl, effective : Bowl and sequence of int
        How the knobs that have an effect are coupled, and which those are.
    starts : sequence of tuple of float
        As of a :class:`KnobsTask`.
    """
    n, scales = rig.count, rig.scales
    root = np.zeros((n, n))
    root[: len(effective), list(effective)] = bowl.root
    corners = np.array(list(itertools.product((0.0, 1.0), repeat=n)))
    far = float(np.linalg.norm((corners - best) @ root.T, axis=1).max())
    steepness, whole, middle = float(np.linalg.norm(root[:, knob])), scales[knob], best[knob]
    low, high = whole.u(part.theta(np.array([0.0, 1.0])))
    side, longest = max((1.0, high - middle), (-1.0, middle - low), key=lambda way: way[1])

    def place(way: Array) -> Array:
        """Return positions on the section."""
        return part.u(whole.theta(middle + side * np.minimum(way, longest)))

    grid = np.linspace(0.0, 1.0, GRID)
    ways = np.asarray(far / steepness * grid, np.float64)
    beyond = Bowl(bowl.floor, np.zeros(1), np.array([[steepness]]))
    rise = task.sense * (beyond.log(ways[:, None]) - beyond.log(np.minimum(ways, longest)[:, None]))
    at = place(ways)
    surrogates = {
        omega_h: [
            s._replace(
                levels=np.interp(at, grid, s.levels) + rise,
                amplitudes=np.interp(at, grid, s.amplitudes) + rise,
                u=np.abs(whole.u(part.theta(s.u)) - middle) * steepness / far,
                low=0.0, high=1.0, logarithmic=False,
            )
            for s in rigs
        ]
        for omega_h, rigs in task.surrogates.items()
    }  # fmt: skip
    several = replace(
        task, surrogates=surrogates, coarse={}, scale=Scale(0.0, 1.0), low=0.0, high=1.0,
        rate=task.rate / (task.scale.high - task.scale.low),
        settings=replace(task.settings, length=n * task.settings.length),
    )  # fmt: skip
    speed = np.zeros(n)
    speed[knob] = task.speed * (high - low)
    low, high = (np.array([getattr(s, end) for s in scales]) for end in ("low", "high"))
    logarithmic = np.array([s.logarithmic for s in scales])
    return KnobsTask(several, KnobsBowl(low, high, logarithmic, best, root / far), starts, speed)
