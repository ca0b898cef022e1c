"""What a law is put in a loop with: the paper's plant or a rig of the family, and a cost."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import ConfigError
from koop_loop.loop import initial_state
from koop_study.family import oscillator
from koop_study.family.config import FamilyConfig
from koop_study.family.oscillator import RigParams
from koop_study.family.rig import Rig, draw
from koop_study.laws import loop
from koop_study.laws.catalogue import LAWS, Constants
from koop_study.laws.loop import Law, LoopState, Sensing
from koop_study.simulation.case import Case, model_of, override, seeded
from koop_study.simulation.scenario import Exposure, expose
from koopman_lifter import contrast, cost
from koopman_lifter.config import SOURCES
from koopman_lifter.cost import Lifting
from koopman_lifter.delays import Delays
from koopman_lifter.edmd import Gram
from koopman_lifter.model import build
from koopman_lifter.observables import Monomials
from relay_esc.config import EscConfig
from relay_esc.relay import RelayState
from vdp_plant.dynamics import PlantParams
from vdp_plant.waves import waves_of

TIMEOUT = 0.5  # silence after which a stream resumes [s]
LEVELS, REST = 16, 8.0  # of the recording that a rig's contrast is learned from; rest in its time
DELAYS = {1: 6, 2: 4}  # samples of each channel that a contrast sees, by channels; else 3
SPACING = 12.0  # of them in a period
ESC = ("dwell", "tau_f", "step_ratio", "lost")  # constants of the node's laws as they are
GRAIN = 1e-3  # resolution of a sensor over its signal, rms


@dataclass(frozen=True)
class PlantConfig:
    """A plant with a cost, as an experiment file declares it.

    Attributes
    ----------
    name : str
        Of its table.
    family : bool
        Whether each seed draws a rig; otherwise the paper's plant.
    cost : str
        On the family ``raw`` or ``contrast``, of a recording of the rig; on the paper's plant any.
    duration : float
        Of a run: seconds on the paper's plant, on the family multiples of the rig's time.
    time : float
        What the laws' times are multiples of on the paper's plant [s].
    settings : dict
        Of the paper's plant, as in the other experiments, or of the family.
    """

    name: str
    family: bool
    cost: str
    duration: float
    time: float = 15.0
    settings: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.family and self.cost not in COSTS_OF_RIGS:
            raise ConfigError(f"cost = {self.cost!r}: on the family raw or contrast")
        if not 0.0 < self.duration <= 1e6:
            raise ConfigError(f"duration = {self.duration:g}: must be above 0 and at most 1e6")
        if not 0.0 < self.time <= 1e6:
            raise ConfigError(f"time = {self.time:g}: must be above 0 and at most 1e6 s")

    def rigs(self) -> FamilyConfig:
        """Return the family."""
        return family_of(self.settings)

    def case(self) -> Case:
        """Return the paper's loop."""
        given = {"cost": self.cost, "duration": self.duration, **self.settings}
        return override(Case(), given)


def family_of(settings: dict[str, Any]) -> FamilyConfig:
    """Return a family from settings that were checked when they were read."""
    ranges: dict[str, Any] = {
        k: tuple(map(float, v)) if isinstance(v, list) else v for k, v in settings.items()
    }
    return FamilyConfig(**ranges)


COSTS_OF_RIGS = ("raw", "contrast")
NO_NOISE = np.zeros((0, 3))
PAPER = Case().plant.params()
NO_EXPOSURE = Exposure(
    np.empty((0, 2)), np.empty(0, np.bool_), np.empty(0), np.empty(0), waves_of(PAPER, 0)
)


@dataclass(frozen=True)
class Setting:
    """One plant of one seed, ready to run under any law.

    Attributes
    ----------
    is_rig, plant, exposure, rig, noise
        What :func:`koop_study.laws.loop.drive` takes; ``rig`` is a placeholder on the paper's
        plant.
    truth : Rig or None
        Of the family.
    lifting : Lifting
        Of the cost.
    source : int
        RAW or LIFTED.
    sense : float
        +1 where r is to be minimised.
    time : float
        What the laws' times are multiples of [s].
    frequency : float
        Of the oscillation [Hz].
    dt : float
        Sampling time [s].
    steps : int
        Of a run.
    start : tuple of float
        The plant's two states.
    u : float
        Position of theta where a run begins.
    seed : int
        What all of it was drawn from.
    """

    is_rig: bool
    plant: PlantParams
    exposure: Exposure
    rig: RigParams
    noise: NDArray[np.float64]
    truth: Rig | None
    lifting: Lifting
    source: int
    sense: float
    time: float
    frequency: float
    dt: float
    steps: int
    start: tuple[float, float]
    u: float
    seed: int

    def t(self) -> NDArray[np.float64]:
        """Return the times of the steps [s]."""
        return np.asarray(np.arange(self.steps) * self.dt)

    def theta_at(self, u: float) -> float:
        """Return theta at a position."""
        if self.truth is not None:
            return float(oscillator.theta_at(self.rig, u))
        return self.plant.theta_min + u * (self.plant.theta_max - self.plant.theta_min)

    def best_u(self) -> float:
        """Return the position at which theta had best rest for the whole run."""
        if self.truth is not None:
            theta, _ = self.truth.best_fixed(self.steps * self.dt)
            return float(oscillator.position(self.rig, theta))
        away = float(np.median(self.exposure.displaced)) if self.exposure.displaced.size else 0.0
        low, high = self.plant.theta_min, self.plant.theta_max
        return (self.plant.theta_star + away - low) / (high - low)

    def sensing(self, constants: Constants) -> Sensing:
        """Return what makes the cost, the detector's corners in units of the plant."""
        detector = cost.detector_params(
            constants["omega_h"] * 2.0 * math.pi * self.frequency,
            constants["omega_l"] / self.time,
            self.dt,
        )
        work = cost.workspace(self.lifting)
        # a slow rig's samples may be further apart than any timeout; none of them are lost
        timeout = 0.0 if self.is_rig else TIMEOUT
        return Sensing(self.source, self.lifting, detector, timeout, self.sense, work)

    def law(self, name: str, constants: Constants) -> tuple[Law, RelayState]:
        """Return a law with its constants, and the relay's first state."""
        spec = LAWS[name]
        p = np.array([*spec.pack({**constants, "seed": float(self.seed)}, self.time), 0.0])
        esc = self.esc(name, constants)
        return Law(spec.kind, esc.params(), p), esc.initial()

    def esc(self, name: str, constants: Constants) -> EscConfig:
        """Return the node's controller with theta in units of u and times in the plant's own."""
        dt = self.dt / self.time
        step = constants.get("speed", 0.0) * dt
        own: dict[str, Any] = {key: constants[key] for key in ESC if key in constants}
        return EscConfig(
            law="adaptive" if name == "adaptive" else "relay",
            theta_min=0.0, theta_max=1.0, theta_initial=self.u, step_size=step, dt=dt,
            objective="minimise" if self.sense > 0.0 else "maximise", **own,
        )  # fmt: skip

    def initial(self, relay_state: RelayState) -> LoopState:
        """Return the loop before its first step."""
        return loop.initial(*self.start, self.theta_at(self.u), self.u, relay_state)


def setting(config: PlantConfig, seed: int) -> Setting:
    """Draw one plant."""
    return of_family(config, seed) if config.family else of_paper(config, seed)


def of_paper(config: PlantConfig, seed: int) -> Setting:
    """Return the paper's plant with all that a seed of the study draws."""
    case = seeded(config.case(), seed)
    model = model_of(case)
    # the actuator's own bounds are wider and never met; the laws' range is the controller's
    plant = case.plant.params()._replace(theta_min=case.esc.theta_min, theta_max=case.esc.theta_max)
    x, y = initial_state(case.plant)
    return Setting(
        False, plant, expose(case.scenario, case.plant, case.steps, seed), PLACEHOLDER, NO_NOISE,
        None, cost.no_lifting() if model is None else model.lifting(),
        SOURCES["raw" if model is None else "lifted"], 1.0, config.time,
        case.plant.mu / (2.0 * math.pi), case.plant.dt, case.steps, (x, y),
        (case.esc.theta_initial - plant.theta_min) / (plant.theta_max - plant.theta_min), seed,
    )  # fmt: skip


def of_family(config: PlantConfig, seed: int) -> Setting:
    """Return a rig, with a model of a recording of its own if the cost needs one."""
    rig = draw(config.rigs(), seed)
    p = rig.params
    time = time_of(rig)
    steps = round(config.duration * time / p.dt)
    source = SOURCES["raw"] if config.cost == "raw" else SOURCES["lifted"]
    lifting = (
        cost.no_lifting() if config.cost == "raw" else learned(json.dumps(config.settings), seed)
    )
    state = rig.initial(seed)
    return Setting(
        True, PAPER, NO_EXPOSURE, p, rig.noise(steps, seed), rig, lifting, source, p.sense, time,
        rig.frequency, p.dt, steps, (state.re, state.im),
        float(oscillator.position(p, rig.theta_initial)), seed,
    )  # fmt: skip


def time_of(rig: Rig) -> float:
    """Return what the laws' times are multiples of [s]."""
    return rig.slowest + 2.0 / rig.frequency


@lru_cache(maxsize=128)
def learned(family: str, seed: int) -> Lifting:
    """Return the contrast of a rig, learned from a recording of it made earlier.

    Theta rests at levels in random order; the second half of each rest is two windows.
    ``family`` are the settings as JSON, which can be a key.
    """
    rig = draw(family_of(json.loads(family)), seed)
    p = rig.params
    rest = round(REST * time_of(rig) / p.dt)
    order = np.random.default_rng([seed, 4]).permutation(LEVELS) / (LEVELS - 1.0)
    theta = np.repeat([oscillator.theta_at(p, u) for u in order], rest)
    x, _ = rig.record(theta, seed + 1_000_000)
    # a sensor's resolution: samples of a limit cycle without any noise depend on each other
    grain = np.random.default_rng([seed, 5]).standard_normal(x.shape) * (GRAIN * x.std(axis=0))
    channels = np.ascontiguousarray((x + grain).T)
    every = max(1, round(1.0 / (rig.frequency * p.dt * SPACING)))
    delays = Delays(rig.channels, DELAYS.get(rig.channels, 3), every)
    length = rest // 4
    starts = np.concatenate(
        [np.array([rest // 2, rest // 2 + length]) + i * rest for i in range(LEVELS)]
    )
    covariances, means = contrast.moments(channels, starts, length, delays)
    gram = Gram.empty(Monomials(delays.n, 1))
    gram.add_trajectory(delays.embed(channels[:, : 4 * rest]))
    names = tuple(f"x{i}" for i in range(rig.channels))
    model = build(gram, p.dt, names, 1, {}, delays)
    return contrast.with_contrast(model, covariances, means, theta[starts]).lifting()


PLACEHOLDER = draw(FamilyConfig(), 0).params
