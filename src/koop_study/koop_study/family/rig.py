"""Draw a rig from a family by its seed; its true values follow from its definition."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from koop_study.family import oscillator
from koop_study.family.config import LOGARITHMIC, WITH_OPTIMUM, FamilyConfig
from koop_study.family.oscillator import RigParams, RigState
from koop_study.family.settings import FAMILY

HOUR = 3600.0  # [s]
GRID = np.linspace(0.0, 1.0, 2001)  # of u, where a truth has no formula
# each has random numbers of its own, by its place: a changed range changes nothing else, and what
# is not drawn any more (the optimum's jumps) keeps its place
QUANTITIES = (
    "noise_driven", "frequency", "samples", "log_scaled", "theta_scale", "theta_offset", "map",
    "maximised", "optimum", "depth", "side", "flat", "power", "amplitude_time", "exponent",
    "amplitude", "channels", "mix", "harmonic", "jitter", "offset", "quiet", "noise", "clean",
    "interference", "common", "tones", "drift", "jump", "jump_every", "start", "width", "skirts",
    "shallower", "apart", "second", "second_mix", "play", "quicker",
)  # fmt: skip


@dataclass(frozen=True)
class RandomRig:
    """A rig and its true values."""

    seed: int
    """That it was drawn from."""
    map: str
    """One of :data:`koop_study.family.config.MAPS`."""
    frequency: float
    """Frequency of the oscillation [Hz]."""
    theta_initial: float
    """Where a run begins: at least a quarter of the range from the optimum."""
    params: RigParams
    """For the compiled step."""

    @property
    def channels(self) -> int:
        """Number of measured channels."""
        return int(self.params.offset.size)

    @property
    def objective(self) -> str:
        """Aim of the rig's owner for the oscillation: ``minimise`` or ``maximise``."""
        return "minimise" if self.params.sense > 0.0 else "maximise"

    @property
    def has_optimum(self) -> bool:
        """Whether there is one inside the range that can be found."""
        return self.map in WITH_OPTIMUM

    def amplitude(self, theta: float, t: float = 0.0) -> float:
        """Return the true amplitude at a resting theta; with a play, at the one that acts."""
        p = self.params
        return float(oscillator.level(p, oscillator.position(p, theta), t))

    def relaxation(self, theta: float, t: float = 0.0) -> float:
        """Return the time constant [s] of the amplitude at a resting theta."""
        return float(oscillator.relaxation(self.params, self.amplitude(theta, t)))

    @property
    def slowest(self) -> float:
        """Largest time constant [s] of the amplitude over the range of theta, at t = 0."""
        p, settled = self.params, oscillator.levels(self.params, GRID, 0.0)
        extremes = float(settled.min()), float(settled.max())  # tau is monotone in the level
        return max(float(oscillator.relaxation(p, end)) for end in extremes)

    @property
    def time(self) -> float:
        """The rig's own time [s], in which a step of theta shows: slowest time and two periods."""
        return self.slowest + 2.0 / self.frequency

    def best(self, t: float = 0.0) -> tuple[float, float]:
        """Return the best theta at a time [s] and the amplitude there.

        The middle of a flat bottom; an end of the range of a monotone map.
        """
        p = self.params
        if p.shape == oscillator.MONOTONE:
            u = 0.0 if p.sense * p.width_above > 0.0 else 1.0
        else:
            u = oscillator.best_position(p, t)
        return oscillator.theta_at(p, u), float(oscillator.level(p, u, t))

    def best_fixed(self, duration: float) -> tuple[float, float]:
        """Return the theta that is best if it rests for ``duration`` [s], and the amplitude then.

        The amplitude is the root mean square over that time. Without a motion of the optimum it is
        :meth:`best`; with one it is looked for among thetas a 2000th of the range apart.
        """
        p = self.params
        if p.drift == 0.0:
            return self.best()
        times = np.linspace(0.0, duration, 101)
        squares = np.mean([oscillator.levels(p, GRID, t) ** 2 for t in times], axis=0)
        i = int(np.argmin(p.sense * squares))
        return oscillator.theta_at(p, GRID[i]), math.sqrt(squares[i])

    def excess(self, theta: float, duration: float) -> float:
        """Return the amplitude of a resting theta over that of the best fixed one.

        Both over a time [s], see :meth:`best_fixed`; the inverse where it is to be large.
        """
        times = np.linspace(0.0, duration, 101)
        square = np.mean([self.amplitude(theta, t) ** 2 for t in times])
        return float(math.sqrt(square) / self.best_fixed(duration)[1]) ** self.params.sense

    def later(self, t: float) -> RandomRig:
        """Return the rig as it is after ``t`` [s]: its optimum is where it has moved to by then."""
        p = self.params
        if p.drift == 0.0:
            return self
        inside = 1.0 - 2.0 * FAMILY.margin
        turned = (p.best - FAMILY.margin + p.drift * t) % (2.0 * inside) > inside
        best = float(oscillator.best_position(p, t))
        return replace(self, params=p._replace(best=best, drift=-p.drift if turned else p.drift))

    def initial(self, seed: int) -> RigState:
        """Return a state that has settled at ``theta_initial``, of a random phase."""
        rng = np.random.default_rng([seed, 2])
        p, u = self.params, float(oscillator.position(self.params, self.theta_initial))

        def settled(size: float) -> tuple[float, float]:
            if p.kind == oscillator.NOISE_DRIVEN:
                re, im = rng.normal(0.0, size * math.sqrt(0.5), 2)
                return float(re), float(im)
            phase = rng.uniform(0.0, 2.0 * math.pi)
            return size * math.cos(phase), size * math.sin(phase)

        if p.shape != oscillator.TWO_MODES:
            return RigState(*settled(float(oscillator.level(p, u, 0.0))), 0.0, 0.0, u)
        first, second = oscillator.two_modes(p, u, 0.0)
        return RigState(*settled(first), *settled(second), u)

    def noise(self, steps: int, seed: int) -> NDArray[np.float64]:
        """Return the standard normal numbers of a run, shape (steps, 2 + channels)."""
        return np.random.default_rng([seed, 3]).standard_normal((steps, 2 + self.channels))

    def record(
        self, theta: NDArray[np.float64], seed: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Run along a given theta from t = 0 on.

        Parameters
        ----------
        theta : ndarray, shape (M,)
            Control input of each step.
        seed : int
            Seed of the noise and the first phase.

        Returns
        -------
        x : ndarray, shape (M, n)
            Measured channels.
        amplitude : ndarray, shape (M,)
            True one, see :func:`oscillator.energy`.
        """
        x = np.empty((theta.size, self.channels))
        amplitude = np.empty(theta.size)
        noise = self.noise(theta.size, seed)
        oscillator.run(self.params, self.initial(seed), 0, theta, noise, x, amplitude)
        return x, amplitude


class _Draws:
    """Random numbers of one rig: each quantity has a stream of its own."""

    def __init__(self, config: FamilyConfig, seed: int) -> None:
        self.config = config
        self._streams = {
            name: np.random.default_rng([seed, 1, i]) for i, name in enumerate(QUANTITIES)
        }

    def __getitem__(self, name: str) -> np.random.Generator:
        return self._streams[name]

    def of(self, name: str) -> float:
        """Return a number of the family's range of that name."""
        low, high = getattr(self.config, name)
        if name in LOGARITHMIC:
            return float(np.exp(self[name].uniform(math.log(low), math.log(high))))
        return float(self[name].uniform(low, high))

    def happens(self, name: str) -> bool:
        """Return True with the family's share of that name."""
        return bool(self[name].random() < getattr(self.config, name))

    def sign(self, name: str) -> float:
        """Return 1 or -1."""
        return 1.0 if self[name].random() < 0.5 else -1.0


def draw(config: FamilyConfig, seed: int) -> RandomRig:
    """Draw one rig; the same family and seed give the same rig.

    A quantity's range does not touch what is drawn of the others: with another ``interference``
    the rest of the rig is as it was.
    """
    d = _Draws(config, seed)
    names = sorted(config.maps)
    weights = np.array([config.maps[name] for name in names])
    chosen = names[int(d["map"].choice(len(names), p=weights / weights.sum()))]
    noise_driven = d.happens("noise_driven")
    maximised = d.happens("maximised") and chosen != "two-modes"  # whose sum has no inner maximum
    frequency = d.of("frequency")
    samples = int(d["samples"].integers(FAMILY.samples_low, FAMILY.samples_high, endpoint=True))
    theta_min, theta_max, log_scale = _range(d)
    best = d.of("optimum")
    size = d.of("amplitude")
    tau = d.of("amplitude_time") / frequency
    low, high = (time / frequency for time in config.amplitude_time)
    growth = config.growth
    params = RigParams(
        kind=oscillator.NOISE_DRIVEN if noise_driven else oscillator.LIMIT_CYCLE,
        turn=2.0 * math.pi / samples,
        jitter=d.of("jitter") / math.sqrt(samples),
        dt=1.0 / (frequency * samples),
        theta_min=theta_min,
        theta_max=theta_max,
        log_scale=log_scale,
        sense=-1.0 if maximised else 1.0,
        best=best,
        level=size,
        **_map(d, chosen, best),
        play=d.of("play"),
        drift=0.0,
        tau=tau,
        # a weak noise-driven oscillation is one of strong damping, which settles fast; a weak
        # limit cycle one whose growth is slow
        exponent=float(d["exponent"].uniform(0.0, 2.0) if noise_driven
                       else d["exponent"].uniform(-growth[1], -growth[0])),
        tau_low=low / d.of("quicker"),
        tau_high=high,
        middle=size,
        second=d.of("second"),
        mix=np.zeros((1, 5)),
        offset=np.zeros(1),
        noise=np.zeros(1),
        tone=np.zeros(0),
        tone_amplitude=np.zeros((0, 1)),
        tone_phase=np.zeros((0, 1)),
    )  # fmt: skip
    settled = oscillator.levels(params, GRID, 0.0)
    params = _sensors(d, params._replace(middle=math.sqrt(settled.min() * settled.max())), chosen)
    start = float(d["start"].choice(GRID[np.abs(GRID - best) >= FAMILY.far]))
    rig = RandomRig(seed, chosen, frequency, oscillator.theta_at(params, start), params)
    drift = d.of("drift") / max(HOUR, FAMILY.slow * rig.slowest) * d.sign("drift")
    return replace(rig, params=params._replace(drift=drift))


def _range(d: _Draws) -> tuple[float, float, bool]:
    """Return theta_min, theta_max and whether the scale is logarithmic."""
    if d.happens("log_scaled"):
        low, high = (math.log(end) for end in d.config.theta_scale)
        width = (high - low) * d["theta_scale"].uniform(1.0 / 6.0, 0.5)  # 1 to 3 decades of 6
        begin = d["theta_offset"].uniform(low, high - width)
        return math.exp(begin), math.exp(begin + width), True
    scale = d.of("theta_scale")
    middle = scale * d["theta_offset"].uniform(-1.0, 1.0)
    return middle - 0.5 * scale, middle + 0.5 * scale, False


def _map(d: _Draws, name: str, best: float) -> dict[str, Any]:
    """Return what the parameters say of the map of a name."""
    depth, power = d.of("depth"), d.of("power")
    flat = d.of("flat") if name == "flat-bottomed" else 0.0

    def width(way: float, depth: float) -> float:
        """Return w for a gain of ``depth`` at a distance of ``way``."""
        return float(max(way - flat, 0.01) / (depth**2 - 1.0) ** (0.5 / power))

    shape, saturation, apart, other_width, shallower = oscillator.BOWL, math.inf, 0.0, 1.0, 1.0
    below, above = width(best, depth), width(1.0 - best, depth)
    if name == "monotone":
        shape, above = oscillator.MONOTONE, d.sign("side") * math.log(depth)
    elif name == "flat":
        shape = oscillator.FLAT
    elif name == "narrow":
        saturation, below = depth, 0.5 * d.of("width")
        above = below
        power = min(max(math.log(depth) / math.log(d.of("skirts") / below), 0.5), 2.0)
    elif name == "two-valleys":
        shape, shallower, below = oscillator.TWO_VALLEYS, d.of("shallower"), 0.5 * d.of("width")
        above = below
        apart = d.of("apart") * (1.0 if best < 0.5 else -1.0)
        other_width = width(max(best + apart, 1.0 - best - apart), max(depth / shallower, 1.5))
    elif name == "two-modes":  # about as deep on both sides
        shape = oscillator.TWO_MODES
        below = math.log(depth / math.sqrt(best)) / best
        above = math.log(depth / math.sqrt(1.0 - best)) / (1.0 - best)
    elif name == "one-sided":
        slight = float(d["side"].uniform(FAMILY.slight_low, FAMILY.slight_high))
        if d["side"].random() < 0.5:
            below = width(best, slight)
        else:
            above = width(1.0 - best, slight)
    elif name != "asymmetric":  # an asymmetric one is as deep on both sides, however near its end
        below = above = width(max(best, 1.0 - best), depth)
    return {
        "shape": shape, "width_below": below, "width_above": above, "flat": flat, "power": power,
        "saturation": saturation, "apart": apart, "other_width": other_width,
        "shallower": shallower,
    }  # fmt: skip


def _second_gain(p: RigParams, gain: NDArray[np.float64]) -> float:
    """Return the factor of a second mode's gains with which all channels together show both alike.

    Each channel is in units of its own strongest motion, as in the measured amplitude: the true
    one, the root of L_1^2 + L_2^2, is then proportional to that.
    """
    squares = np.array([oscillator.two_modes(p, float(u), 0.0) for u in GRID]) ** 2

    def more(log_factor: float) -> float:
        gains = np.array([gain, math.exp(log_factor) * gain[::-1]]) ** 2
        shares = gains / (squares @ gains).max(axis=0)
        return float((shares[1] - shares[0]).sum())

    return math.exp(brentq(more, -20.0, 20.0))


def _sensors(d: _Draws, p: RigParams, name: str) -> RigParams:
    """Add channels, their noise and the interference."""
    low, high = d.config.channels
    n = int(d["channels"].integers(round(low), round(high), endpoint=True))
    mix = np.empty((n, 5))
    angle = d["mix"].uniform(0.0, 2.0 * math.pi, n)
    gain = np.exp(d["mix"].uniform(math.log(0.5), math.log(2.0), n))
    mix[:, 0], mix[:, 1] = gain * np.cos(angle), gain * np.sin(angle)
    angle = d["second_mix"].uniform(0.0, 2.0 * math.pi, n)
    second = gain[::-1] * (_second_gain(p, gain) if name == "two-modes" else 1.0)
    mix[:, 3], mix[:, 4] = second * np.cos(angle), second * np.sin(angle)
    mix[:, 2] = [d.of("harmonic") for _ in range(n)]
    rms = p.middle * math.sqrt(0.5)  # of Re z at the middle level
    noise = 0.0 if d.happens("quiet") else d.of("noise")
    noise = FAMILY.drowning if name == "drowned" else noise
    ratio = 0.0 if d.happens("clean") else d.of("interference")
    count = int(d["tones"].integers(1, 2, endpoint=True)) if ratio > 0.0 else 0
    omega = 2.0 * math.pi / (p.dt * (2.0 * math.pi / p.turn))
    bands = (d.config.lower_tones, d.config.upper_tones)
    band = [bands[i] for i in d["tones"].integers(0, 2, count)]
    tone = omega * np.exp([d["tones"].uniform(math.log(a), math.log(b)) for a, b in band])
    # rms of the sum of all tones is the ratio's
    amplitude = np.full((count, n), ratio * rms * math.sqrt(2.0 / max(count, 1)))
    phase = np.repeat(d["tones"].uniform(0.0, 2.0 * math.pi, (count, 1)), n, axis=1)
    if not d.happens("common"):
        amplitude *= np.exp(d["common"].uniform(math.log(0.5), math.log(2.0), n))
        phase -= 2.0 * math.pi * FAMILY.lag * d["common"].uniform(0.0, 1.0, n)
    return p._replace(
        mix=mix,
        offset=d["offset"].uniform(-3.0, 3.0, n) * rms,
        noise=np.full(n, noise * rms),
        tone=np.asarray(tone),
        tone_amplitude=amplitude,
        tone_phase=phase,
    )
