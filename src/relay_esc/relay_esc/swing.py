"""The swing of the adaptive law: how large the relay's steps are, from what the cost shows.

The adaptive law is the relay of :mod:`relay_esc.relay` with its step times a factor in [step_ratio,
1]. docs/explanation/adaptive-law.md says what it does and why. A leg is the way from one flip to
the next; its least level m, the level being log r behind a low-pass filter, is compared with the
leg before (the noise s) and with the legs at home (the reference)::

    home:  m <= reference + 3 s      the optimum is where it was: the reference follows m, and after
                                     four legs that ended as soon as they could the step shrinks,
                                     as long as their dip is to be seen: 0.3 s at least
    lost:  m > reference + 8 s       the step doubles with every leg
    a leg of two dwell times         the same: the optimum is elsewhere
    reference > calm + 0.36          the same: the optimum creeps away, and the reference with it;
                                     calm is its least value since the step was full

From either on until a leg at home the limits open where theta passes them, up to the widest; they
close with a leg at home within them.

No unit of r and no clock stands in a rule: a swing that has become too small to see the optimum
loses it, which the level shows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

from koop_core.config.parameter import Settings, constants, judged, parameter
from koop_core.kernels import njit
from koop_core.named_tuple import replace

GOLDEN = 0.6180339887498949
PAST = 1e6  # of a cost: a filtered change beyond it is of a time when nothing moved
studied = partial(parameter, origin="koop study laws at commit be69197")


@dataclass(frozen=True)
class SwingSettings(Settings):
    """The adaptive law's rules; docs/explanation/adaptive-law.md says what each is for."""

    shrink: float = studied(0.7, "factor of the step at the optimum", low=0.1, high=1.0)
    grow: float = studied(2.0, "factor of the step where the optimum is lost", low=1.0)
    short: float = studied(
        1.15, "longest leg that ended as soon as it could", unit="dwell", low=1.0
    )
    arrived: int = studied(4, "short legs in a row before the step shrinks", low=1)
    home: float = studied(3.0, "level above the reference at the optimum", unit="noise", low=0.0)
    lost: float = studied(
        8.0, "level above the reference from which the optimum is lost", unit="noise", low=3.0
    )
    visible: float = studied(0.3, "least dip that is seen", unit="noise", low=0.0)
    dip_rate: float = studied(0.3, "share of a leg in the mean dip", low=0.0, high=1.0)
    stretch: float = studied(0.5, "largest share that a dwell time is longer", low=0.0)
    wide: float = studied(0.7, "factor of the step from which a leg is wide", low=0.0, high=1.0)
    learned: int = judged(3, "legs from which on the noise is a mean", low=1)
    noise_at_first: float = judged(0.1, "noise before, of log r", low=0.0)
    noise_rate: float = studied(0.2, "share of a leg in the noise", low=0.0, high=1.0)
    noise_rate_away: float = studied(0.02, "the same, off the optimum", low=0.0, high=1.0)
    reference_rate: float = studied(0.5, "share of a leg in the reference", low=0.0, high=1.0)
    reference_rate_away: float = studied(0.05, "the same, off the optimum", low=0.0, high=1.0)
    level_time: float = studied(0.15, "time constant of the level", unit="dwell", low=0.0)
    crept: float = parameter(
        0.36, "rise of the reference from which on the optimum has crept away", low=0.0,
        origin="amplitude 1.2 times what it was",
    )  # fmt: skip
    long: float = studied(
        2.0, "leg that shows that the optimum is elsewhere", unit="dwell", low=1.0
    )
    pull: float = studied(0.5, "share that a step towards the centre is larger", low=0.0, high=1.0)
    centred: int = studied(3, "legs from which on the centre pulls", low=1)
    centre_rate: float = studied(0.1, "share of a leg in the centre", low=0.0, high=1.0)


SWING = constants(SwingSettings())


class Swing(NamedTuple):
    """State of the adaptive law besides the relay's; levels are of log r."""

    factor: float
    """Step in units of the configured one."""
    stretch: float
    """Dwell time of this leg in units of the configured one."""
    level: float
    """Low-pass filtered log r, its sign changed if r is maximised."""
    begin: float
    """Level where this leg begins."""
    lowest: float
    lowest_before: float
    """Least level of this leg, infinite before its first cost, and of the one before."""
    reference: float
    """Level where the optimum is."""
    noise: float
    """Mean change of ``lowest`` from leg to leg."""
    dip: float
    """Mean dip of the legs, the latest counting most."""
    legs: int
    """Legs that the level is known of."""
    short: int
    """Legs in a row that ended as soon as they could, at home."""
    turned: float
    """u where this leg begins."""
    centre: float
    """Mean u of the legs at home."""
    centred: int
    """Legs that it is a mean of."""
    cost: float
    """Last r, its inverse if r is maximised."""
    rise: float
    """Filtered change of ``cost``, as the relay's."""
    below: float
    beyond: float
    """How far the lower and the upper limit are open [u]."""
    calm: float
    """Least reference since the step was full."""


OPEN = Swing(
    1.0, 1.0, 0.0, 0.0, math.inf, 0.0, 0.0, 0.0, 0.0, 0, 0, 0.0, 0.0, 0, 0.0, 0.0, 0.0, 0.0, 0.0
)
"""Full step, nothing known; the relay of the paper never leaves it."""


@njit()
def follow(
    swing: Swing, alpha_level: float, x: float, alpha: float, cost: float, primed: bool
) -> Swing:
    """Take one cost into the level, as x = log r, and into its rise, as r.

    Where r is maximised, the sign of ``x`` is changed and ``cost`` is 1 / r. ``primed`` says
    whether there is a cost before it to take the difference from.
    """
    first = swing.lowest == math.inf
    level = x if first else alpha_level * swing.level + (1.0 - alpha_level) * x
    rise = alpha * swing.rise + (1.0 - alpha) * (cost - swing.cost) if primed else swing.rise
    rise = min(max(rise, -PAST * cost), PAST * cost)
    begin, lowest = level if first else swing.begin, min(swing.lowest, level)
    return replace(swing, level=level, begin=begin, lowest=lowest, cost=cost, rise=rise)


@njit()
def forget_leg(swing: Swing) -> Swing:
    """Leave out what the cost did before a silence: level and rise begin with the next cost."""
    return replace(swing, short=0, level=0.0, begin=0.0, lowest=math.inf, cost=0.0, rise=0.0)


@njit()
def widen(swing: Swing) -> Swing:
    """Double the step: the leg is long."""
    return replace(swing, factor=min(1.0, swing.factor * SWING.grow), short=0)


@njit()
def gain(swing: Swing, u: float, epsilon: int) -> float:
    """Return the step in units of the configured one: larger towards the centre than away."""
    if swing.factor == 1.0 or swing.centred < SWING.centred:
        return swing.factor
    towards = (u - swing.centre) * epsilon > 0.0  # epsilon +1 moves u down
    return (
        min(1.0, swing.factor * (1.0 + SWING.pull))
        if towards
        else swing.factor * (1.0 - SWING.pull)
    )


@njit()
def turn(swing: Swing, length: float, u: float, least: float, inside: bool) -> Swing:
    """End a leg at ``u``, after ``length`` dwell times: judge it and set the step of the next one.

    ``least`` is the smallest factor; ``inside``: the leg was within the limits as configured.
    """
    factor, reference, noise, short = swing.factor, swing.reference, swing.noise, swing.short
    lowest, dip = swing.lowest, swing.dip
    centre, centred = swing.centre, swing.centred
    below, beyond = swing.below, swing.beyond
    if swing.legs == 0:
        reference, noise = lowest, SWING.noise_at_first
    else:
        change = abs(lowest - swing.lowest_before)
        above = lowest - reference
        home = above <= SWING.home * noise
        risen = above > SWING.lost * noise
        if swing.legs < SWING.learned:
            noise = max(noise, change)
        else:  # a jump of the level is not noise
            rate = SWING.noise_rate if home else SWING.noise_rate_away
            noise += rate * (min(change, 3.0 * noise) - noise)
        dip += SWING.dip_rate * (min(swing.begin, swing.level) - lowest - dip)
        if home:
            visible = dip >= SWING.visible * noise
            short = short + 1 if visible and length <= SWING.short * swing.stretch else 0
            if short >= SWING.arrived:
                factor = max(least, factor * SWING.shrink)
            reference = reference + SWING.reference_rate * above if above > 0.0 else lowest
            if length <= SWING.long:
                centred += 1
                middle = 0.5 * (swing.turned + u)
                centre += max(1.0 / centred, SWING.centre_rate) * (middle - centre)
            if inside:
                below = beyond = 0.0
        else:
            short = 0
            reference += SWING.reference_rate_away * above
            if risen:
                factor = min(1.0, factor * SWING.grow)
        if risen or length > SWING.long:
            centred = 0
    calm = reference if swing.legs == 0 or swing.factor == 1.0 else min(swing.calm, reference)
    if reference > calm + max(SWING.crept, SWING.lost * noise):
        factor, short, centred = min(1.0, factor * SWING.grow), 0, 0
    stretch = 1.0
    if factor >= SWING.wide:
        stretch += SWING.stretch * (swing.legs * GOLDEN % 1.0)
    return replace(
        swing, factor=factor, stretch=stretch, begin=swing.level, lowest=swing.level,
        lowest_before=lowest, reference=reference, noise=noise, dip=dip, legs=swing.legs + 1,
        short=short, turned=u, centre=centre, centred=centred, below=below, beyond=beyond,
        calm=calm,
    )  # fmt: skip


@njit(inline="always")
def is_lost(swing: Swing, since_flip: int, dwell_samples: int) -> bool:
    """Return whether no leg was at home since the optimum was lost, or this one is long."""
    long = since_flip >= SWING.long * max(dwell_samples, 1)
    return (swing.centred == 0 or long) and swing.legs > SWING.learned


@njit()
def open_limits(swing: Swing, below: float, beyond: float) -> Swing:
    """Open the limits so far [u], where they are not."""
    return replace(swing, below=max(swing.below, below), beyond=max(swing.beyond, beyond))


@njit()
def confidence(swing: Swing) -> float:
    """Return the confidence that the optimum is within the swing: 1 at the reference, 0 if lost."""
    if swing.legs < 2:
        return 0.0
    above = swing.lowest_before - swing.reference
    if above <= 0.0:
        return 1.0
    return max(0.0, 1.0 - above / (SWING.lost * swing.noise)) if swing.noise > 0.0 else 0.0
