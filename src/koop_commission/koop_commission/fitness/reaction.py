"""Does theta reach the rig? A randomisation test. Pure: arrays in, figures out.

Theta is at one of two values in each of some blocks of time, the same number of blocks each, in an
order that is drawn. If theta reached nothing, the measurements would be what they are whatever the
order: then the order that was drawn gives the largest difference between the two groups no more
often than any other. This holds for any noise, drift and memory of the rig (Fisher, The Design of
Experiments, 1935).
"""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

# Of each series how much longer its blocks are than some periods of what is strongest, which may be
# an interference, and of its stages the blocks and the probability at which each decides.
STAGES = ((8, 0.03), (6, 0.02))
SERIES = ((1.0, STAGES), (4.0, ((10, 0.02),)), (12.0, ((10, 0.02),)))
RANDOM = 999  # orders that a recording is compared with
SMALL = 1e-9  # of a feature's size, below which a difference is rounding


class Reaction(NamedTuple):
    """How the measurements differ between the two values of theta.

    Attributes
    ----------
    p : float
        Probability of such a difference if theta reached nothing.
    feature : int
        Where the difference is clearest.
    change : float
        Its mean difference, moved less not moved.
    """

    p: float
    feature: int
    change: float

    @property
    def confidence(self) -> float:
        """1 - p."""
        return 1.0 - self.p


def order(blocks: int, rng: random.Random) -> list[bool]:
    """Draw in which blocks theta is moved: half of them, every choice as likely."""
    moved = [True] * (blocks // 2) + [False] * (blocks - blocks // 2)
    rng.shuffle(moved)
    return moved


def reaction(
    found: NDArray[np.float64], moved: Sequence[bool], stages: Sequence[int] = ()
) -> Reaction:
    """Test whether the two groups differ.

    Parameters
    ----------
    found : ndarray, shape (blocks, f)
        Features of each block.
    moved : sequence of bool
        Whether theta was moved in it.
    stages : sequence of int
        Blocks of each drawing; default: all were drawn at once.
    """
    sizes = list(stages) or [len(moved)]
    drawn = np.array(moved)
    bounds = np.cumsum([0, *sizes])
    halves = [int(drawn[a:b].sum()) for a, b in itertools.pairwise(bounds)]
    choices = [
        [np.isin(np.arange(size), pick) for pick in itertools.combinations(range(size), half)]
        for size, half in zip(sizes, halves, strict=True)
    ]
    spread = np.maximum(found.std(axis=0), SMALL * (1.0 + np.abs(found).max(axis=0)))
    scaled = (found - found.mean(axis=0)) / spread
    own = _statistic(scaled, drawn)
    every = [
        _statistic(scaled, np.concatenate(parts)).max() for parts in itertools.product(*choices)
    ]
    feature = int(np.argmax(own))
    p = float(np.mean(np.array(every) >= own[feature] * (1.0 - 1e-9)))
    change = float(found[drawn, feature].mean() - found[~drawn, feature].mean())
    return Reaction(p, feature, change)


def reaction_of_rests(
    found: NDArray[np.float64], theta: NDArray[np.float64], seed: int = 0
) -> Reaction:
    """Test whether the measurements differ between the values at which theta rested.

    The statistic is the variance between the values over that within them; its distribution is
    that of 999 random orders. Nobody drew the order of the rests, so that a drift of the rig that
    happened to go with theta is taken for its effect.

    Parameters
    ----------
    found : ndarray, shape (rests, f)
        Features of each rest.
    theta : ndarray, shape (rests,)
        Where theta rested.
    """
    values, group = np.unique(theta, return_inverse=True)
    if values.size > theta.size // 2:  # hardly any value came twice: neighbours are one group
        group = np.argsort(np.argsort(theta)) * (theta.size // 3) // theta.size
    rng = np.random.default_rng(seed)
    own = _between(found, group)
    every = [_between(found, rng.permutation(group)).max() for _ in range(RANDOM)]
    feature = int(np.argmax(own))
    p = (1 + sum(value >= own[feature] for value in every)) / (RANDOM + 1)
    means = [found[group == g, feature].mean() for g in np.unique(group)]
    return Reaction(p, feature, float(np.ptp(means)))


def _between(found: NDArray[np.float64], group: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the variance of the groups' means over the mean variance within them."""
    rows = [found[group == g] for g in np.unique(group)]
    within = np.mean([part.var(axis=0) for part in rows], axis=0)
    return np.asarray(np.var([part.mean(axis=0) for part in rows], axis=0) / (within + 1e-12))


def _statistic(scaled: NDArray[np.float64], moved: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return |Welch's t| of each feature, without its factor; large where groups do not overlap."""
    a, b = scaled[moved], scaled[~moved]
    noise = np.sqrt(a.var(axis=0) + b.var(axis=0))
    return np.asarray(np.abs(a.mean(axis=0) - b.mean(axis=0)) / np.maximum(noise, 1e-3))


def percent(change: float) -> str:
    """Return a difference of logarithms in words.

    >>> percent(math.log(0.5))
    'falls by 50 %'
    """
    if abs(change) > math.log(3.0):
        return f"{'rises' if change > 0 else 'falls'} {math.exp(abs(change)):.3g} times"
    share = 100.0 * (math.exp(change) - 1.0)
    return f"{'rises' if share > 0 else 'falls'} by {abs(share):.2g} %"
