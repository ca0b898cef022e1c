"""The contrast of a rig, learned from a recording of it that was made earlier."""

from __future__ import annotations

import json
from functools import lru_cache

import numpy as np

from koop_study.family import oscillator
from koop_study.family.config import family_of
from koop_study.family.rig import draw
from koop_study.family.settings import FAMILY
from koopman_lifter import contrast
from koopman_lifter.delays import Delays
from koopman_lifter.edmd import Gram
from koopman_lifter.model import KoopmanModel, build
from koopman_lifter.observables import Monomials

DELAYS = {1: 6, 2: 4}  # samples of each channel that a contrast sees, by channels; else 3


@lru_cache(maxsize=128)
def learned_contrast(family: str, seed: int) -> KoopmanModel:
    """Return the contrast of the rig of a seed; ``family`` are the settings as JSON.

    Theta rests at levels in random order; the second half of each rest is two windows.
    """
    rig = draw(family_of(json.loads(family)), seed)
    p = rig.params
    rest = round(FAMILY.rest * rig.time / p.dt)
    order = np.random.default_rng([seed, 4]).permutation(FAMILY.levels) / (FAMILY.levels - 1.0)
    theta = np.repeat([oscillator.theta_at(p, u) for u in order], rest)
    x, _ = rig.record(theta, seed + 1_000_000)
    # a sensor's resolution: samples of a limit cycle without any noise depend on each other
    grain = np.random.default_rng([seed, 5]).standard_normal(x.shape) * (
        FAMILY.grain * x.std(axis=0)
    )
    channels = np.ascontiguousarray((x + grain).T)
    every = max(1, round(1.0 / (rig.frequency * p.dt * FAMILY.spacing)))
    delays = Delays(rig.channels, DELAYS.get(rig.channels, 3), every)
    length = rest // 4
    starts = np.concatenate(
        [np.array([rest // 2, rest // 2 + length]) + i * rest for i in range(FAMILY.levels)]
    )
    covariances, means = contrast.moments(channels, starts, length, delays)
    gram = Gram.empty(Monomials(delays.n, 1))
    gram.add_trajectory(delays.embed(channels[:, : 4 * rest]))
    names = tuple(f"x{i}" for i in range(rig.channels))
    model = build(gram, p.dt, names, 1, {}, delays)
    return contrast.with_contrast(model, covariances, means, theta[starts])
