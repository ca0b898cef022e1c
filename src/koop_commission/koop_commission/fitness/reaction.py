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

SMALL = 1e-9  # share of a feature below which a difference is rounding


class Reaction(NamedTuple):
    """Difference of the measurements between two values of theta.

    Attributes
    ----------
    p : float
        Probability of such a difference if theta reached nothing.
    feature : int
        Feature with the clearest difference.
    change : float
        Its mean difference, theta moved less not moved.
    """

    p: float
    feature: int
    change: float

    @property
    def confidence(self) -> float:
        """1 - p."""
        return 1.0 - self.p


def draw_order(blocks: int, rng: random.Random) -> list[bool]:
    """Draw in which blocks theta is moved: half of them, each choice equally likely."""
    moved = [True] * (blocks // 2) + [False] * (blocks - blocks // 2)
    rng.shuffle(moved)
    return moved


def compare_blocks(
    features: NDArray[np.float64], moved: Sequence[bool], stages: Sequence[int] = ()
) -> Reaction:
    """Test whether the blocks with theta moved differ from the others.

    Parameters
    ----------
    features : ndarray, shape (blocks, f)
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
    spread = np.maximum(features.std(axis=0), SMALL * (1.0 + np.abs(features).max(axis=0)))
    scaled = (features - features.mean(axis=0)) / spread
    statistic = _compute_welch(scaled, drawn)
    every = [
        _compute_welch(scaled, np.concatenate(parts)).max() for parts in itertools.product(*choices)
    ]
    feature = int(np.argmax(statistic))
    p = float(np.mean(np.array(every) >= statistic[feature] * (1.0 - 1e-9)))
    change = float(features[drawn, feature].mean() - features[~drawn, feature].mean())
    return Reaction(p, feature, change)


def _compute_welch(scaled: NDArray[np.float64], moved: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return |Welch's t| of each feature, without its factor."""
    a, b = scaled[moved], scaled[~moved]
    noise = np.sqrt(a.var(axis=0) + b.var(axis=0))
    return np.asarray(np.abs(a.mean(axis=0) - b.mean(axis=0)) / np.maximum(noise, 1e-3))


def describe_change(change: float) -> str:
    """Return a difference of logarithms in words.

    >>> describe_change(math.log(0.5))
    'falls by 50 %'
    """
    if abs(change) > math.log(3.0):
        return f"{'rises' if change > 0 else 'falls'} by a factor of {math.exp(abs(change)):.3g}"
    share = 100.0 * (math.exp(change) - 1.0)
    return f"{'rises' if share > 0 else 'falls'} by {abs(share):.3g} %"
