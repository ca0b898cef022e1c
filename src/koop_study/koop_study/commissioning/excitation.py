"""A rig of the family excited as ``koop excite`` does it: the same decisions, no messages."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koop_identify.model.from_bags import BagTraining
from koop_identify.recording.loaded import Loaded
from koop_identify.recording.samples import recorded_source
from koop_identify.recording.segmentation import BagReading
from koop_study.family import oscillator
from koop_study.family.knobs import KnobsRig
from koop_study.family.rig import RandomRig
from koop_study.family.settings import FAMILY
from koop_tune.excitation.design import DESIGN
from koop_tune.excitation.knobs_design import KnobsDesign
from koop_tune.rig.rig_file import RigFile, state_source


@dataclass(frozen=True)
class SimulatedExcitation:
    """The recording of an excitation."""

    theta: NDArray[np.float64]
    """Shape (M,) or (M, n): control input of each sample; of n knobs."""
    x: NDArray[np.float64]
    """Shape (M, n): measured channels."""
    design: KnobsDesign
    """Its decisions."""
    elapsed: float
    """Time [s]."""

    @property
    def loaded(self) -> Loaded:
        """The recording as it is loaded from a bag."""
        dt = self.design.windows.dt
        return as_loaded(self.theta, self.x, dt).after(int(self.design.since / dt))


def as_loaded(theta: NDArray[np.float64], x: NDArray[np.float64], dt: float) -> Loaded:
    """Return theta, shape (M,), and channels, shape (M, n), as they are loaded from a bag."""
    number = np.arange(theta.shape[0])
    time = np.asarray(number * dt, np.float64)
    return Loaded(np.ascontiguousarray(x.T), number == 0, theta, time)


def longest(rig: RandomRig, time: float) -> float:
    """Return how long an excitation of a knob may take [s], of slowest times and ten periods."""
    return time * (rig.slowest + FAMILY.periods / rig.frequency)


def file_of(rig: RandomRig, rate: float, time: float) -> RigFile:
    """Return the rig file that an engineer would write.

    Parameters
    ----------
    rig : RandomRig
        The rig.
    rate : float
        Largest change of theta: ranges in the rig's own time.
    time : float
        That the excitation may take: slowest times of the amplitude and ten periods.
    """
    p = rig.params
    return RigFile(
        state_source(rig.channels), "/knob:data", dt=p.dt,
        theta_min=p.theta_min, theta_max=p.theta_max, theta_start=rig.theta_initial,
        theta_rate=rate * (p.theta_max - p.theta_min) / rig.time, theta_safe=rig.theta_initial,
        objective=rig.objective, time=max(longest(rig, time), 1.0),
    )  # fmt: skip


def training_of(rig: RandomRig) -> BagTraining:
    """Return how models of the rig are learned."""
    return BagTraining(BagReading(recorded_source("/state:x"), dt=rig.params.dt))


class Running:
    """A rig that runs on, its theta moved at a limited rate; everything is recorded.

    Parameters
    ----------
    rig : RandomRig
        The rig, which has settled at its first theta.
    rate : float
        Largest change of theta per second.
    seed : int
        Seed of noise and first phase.
    knobs : KnobsRig, optional
        Its knobs, if it has several; theta is then that of each.
    """

    def __init__(
        self, rig: RandomRig, rate: float, seed: int, knobs: KnobsRig | None = None
    ) -> None:
        self._rig, self._knobs = rig, knobs
        self._most = rate * rig.params.dt
        self._state = rig.initial(seed)
        self._rng = np.random.default_rng([seed, 3])
        self._theta = np.asarray(rig.theta_initial if knobs is None else knobs.start)
        self._parts: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
        self.steps = 0

    @property
    def elapsed(self) -> float:
        """Time [s]."""
        return self.steps * self._rig.params.dt

    def _run(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        p, count = self._rig.params, theta.shape[0]
        acts = theta if self._knobs is None else self._knobs.theta(theta)
        x, amplitude = np.empty((count, self._rig.channels)), np.empty(count)
        noise = self._rng.standard_normal((count, 2 + self._rig.channels))
        self._state = oscillator.run(p, self._state, self.steps, acts, noise, x, amplitude)
        self.steps += count
        self._parts.append((theta, x))
        return x

    def hold(self, steps: int) -> NDArray[np.float64]:
        """Run for some samples, and return them."""
        return self._run(np.repeat(self._theta[None], steps, axis=0))

    def go(self, theta: ArrayLike) -> None:
        """Move theta."""
        theta = np.asarray(theta, np.float64)
        count = math.ceil(np.abs(theta - self._theta).max() / self._most)
        if count:
            way = np.linspace(self._theta, theta, count + 1)[1:]
            self._run(np.asarray(way, np.float64))
        self._theta = theta

    def recorded(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return theta and the channels from the beginning."""
        theta, x = zip(*self._parts, strict=True)
        return np.concatenate(theta), np.concatenate(x)


def excite(
    rig: RandomRig, file: RigFile, seed: int, knobs: KnobsRig | None = None
) -> SimulatedExcitation:
    """Excite a rig, which may have several knobs, until the static map is known or time is over.

    Raises
    ------
    ValueError
        If no channel moves.
    """
    design = KnobsDesign(file)
    running = Running(rig, min(file.each("theta_rate")), seed, knobs)
    heard = running.hold(math.ceil(DESIGN.shortest / file.dt))
    while design.listens(heard):
        more = max(0.2 * DESIGN.shortest / file.dt, FAMILY.often * heard.shape[0])
        heard = np.concatenate([heard, running.hold(math.ceil(more))])
    design.look(heard)
    for factor in FAMILY.longer:  # an engineer does as the command says
        design.rig = replace(file, time=factor * file.time)
        if _go_on(design, running):
            break
    return SimulatedExcitation(*running.recorded(), design, running.elapsed)


def _go_on(design: KnobsDesign, running: Running) -> bool:
    """Excite until enough is known; return False if the time is over."""
    time = design.rig.time
    while (move := design.next()) is not None:
        for u in (move.via, move.u):
            if u is not None:
                theta = design.rig.theta_at(u)
                running.go(theta if len(theta) > 1 else theta[0])
        design.arrive(move, running.elapsed)
        while not design.take(running.hold(design.windows.length)):
            if running.elapsed > time:
                return False
    return True
