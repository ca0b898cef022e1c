"""The amplitude of the oscillation: of all that reacts to theta, in every channel and frequency.

A window of samples is cut into groups of frequencies. A group reacts if its power differs between
two holds beyond what its errors explain; a line that does not react is interference, and so is what
differs as much between holds at one place. With P_cg the power of group g in channel c, F_cg the
background there and s_c^2 the most that channel c was seen to move,

    A^2 = sum_c w_c sum_{g reacts} (P_cg - F_cg) / s_c^2  /  sum_c w_c

so that 1 is the strongest motion seen. What the background hides is told as a floor:

    A^2 >= sum_c w_c sum_g dF_cg / s_c^2  /  sum_c w_c

with dF the error of F, and q_c^2 / 8 on top where a sensor of step q_c stood still: a sine of up to
half a step is not seen. The background is what the quiet groups beside have, which theta does not
change; and where a group stays at its least while another still falls, what it has there: a line of
interference, or noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from koop_core.config.parameter import Settings, judged, parameter
from koop_tune.origin import studied

TINY = 1e-12  # share of a power, or of a value, that rounding leaves
Array = NDArray[np.float64]


@dataclass(frozen=True)
class AmplitudeSettings(Settings):
    """When a group of frequencies reacts, and how sure its background is."""

    change: float = studied(0.3, "change of a log power that theta makes", low=0.0)
    errors: float = studied(4.0, "standard errors that are subtracted from it", low=0.0)
    shifted: int = parameter(
        4, "windows that begin in the length of one", low=1,
        origin="so many of Blackman's, shifted, count all samples about alike",
    )  # fmt: skip
    ratio: float = parameter(1.12, "width of a group of frequencies", low=1.01, high=2.0)
    single: int = parameter(16, "lowest bins that are groups of their own", low=1)
    lowest: int = parameter(2, "lowest bins that count for nothing", low=0)
    beside: int = parameter(4, "quiet groups to each side that tell a background", low=1)
    doubt: float = studied(0.1, "share of that background that is not known", low=0.0, high=1.0)
    falls: float = studied(
        4.0, "factor of a group's power over its least: what stays where it falls is background",
        low=1.0,
    )  # fmt: skip
    hidden: float = studied(0.3, "background over motion of a channel that is left out", low=0.0)
    slow: float = studied(
        0.1, "share of the power at the lowest frequencies that is left out", low=0.0
    )
    skirt: float = studied(
        0.05, "power over the channel's strongest group, where it is largest, left out", low=0.0
    )
    lobe: int = parameter(
        2, "groups or bins over which a line leaks", low=0, high=3, origin="half a window's lobe"
    )
    line: float = studied(
        0.5, "power of a quiet group over one within the lobe that is left out", low=0.0
    )
    harmonics: tuple[int, ...] = judged((2, 3), "multiples of a frequency that a rig makes of it")
    same: float = judged(0.005, "distance of two holds at one place, in ranges", low=0.0)
    pairs: int = judged(3, "of such holds before they tell what comes and goes", low=1)
    comes: float = judged(
        0.25, "variance of a log power at one place over that of all holds, left out", low=0.0
    )
    ordered: float = judged(
        2.0, "standard deviations by which neighbours are alike that theta orders", low=0.0
    )
    nearly_all: float = judged(
        0.97, "share of what moves that is kept though it comes and goes", low=0.0, high=1.0
    )
    repeated: float = parameter(
        0.25, "different values over samples of a sensor with a step", low=0.0, high=1.0
    )
    unsteady: float = studied(
        0.5, "share of a line's power in a hold that is no tone's", low=0.0, high=1.0
    )
    minor: float = parameter(0.02, "share of the power of a mode that is named", low=0.0, high=1.0)


AMPLITUDE = AmplitudeSettings()


class Windows(NamedTuple):
    """How samples are cut: samples of a window, and time between two [s]."""

    length: int
    dt: float

    @property
    def seconds(self) -> float:
        """Length of a window [s]."""
        return self.length * self.dt

    @property
    def edges(self) -> tuple[int, ...]:
        """Bins of the spectrum at which groups begin, and the one beyond the last group."""
        return _edges(self.length // 2 + 1, AMPLITUDE.single, AMPLITUDE.ratio)

    @property
    def frequency(self) -> Array:
        """Frequency in the middle of each group [Hz], shape (G,)."""
        edges = np.array(self.edges)
        return np.asarray(0.5 * (edges[:-1] + edges[1:] - 1) / self.seconds)

    def powers(self, x: Array) -> Array:
        """Return the power in each group of each whole window.

        It is the mean of windows that are shifted by parts of their length (Welch, IEEE
        Transactions on Audio and Electroacoustics 15 (1967) 70-73). Alone, each would see little
        but its middle: two lines that are close beat, and consecutive windows would see the same
        phase of that for a whole hold.

        Parameters
        ----------
        x : ndarray, shape (M, n)
            Samples; those that are not finite are bridged.

        Returns
        -------
        ndarray, shape (W, n, G)
            In squared units of the channel; the sum over the groups is about the variance.
        """
        count, shifted = x.shape[0] // self.length, AMPLITUDE.shifted
        shifts = (np.arange(shifted) - 0.5 * (shifted - 1)) / shifted
        starts = (self.length * (np.arange(count)[:, None] + shifts)).astype(int)
        starts = np.clip(starts, 0, max(x.shape[0] - self.length, 0))
        cut = sliding_window_view(bridge_gaps(x), self.length, axis=0)[starts.ravel()]
        taper = np.blackman(self.length)
        spectrum = np.abs(np.fft.rfft(_detrended(cut) * taper)) ** 2
        spectrum *= 2.0 / (self.length * float((taper**2).sum()))
        groups = np.add.reduceat(spectrum, self.edges[:-1], axis=2)
        # what rounding leaves of a channel that stands still, such as theta's own position
        groups[groups.sum(axis=2) < (TINY * np.abs(cut).max(axis=2)) ** 2] = 0.0
        return np.asarray(groups.reshape(count, shifted, *groups.shape[1:]).mean(axis=1))


@lru_cache
def _edges(bins: int, single: int, ratio: float) -> tuple[int, ...]:
    edges = list(range(1, min(single, bins) + 1))
    while edges[-1] < bins:
        edges.append(min(max(edges[-1] + 1, round(edges[-1] * ratio)), bins))
    return tuple(edges)


class Mode(NamedTuple):
    """Neighbouring frequencies of a channel that react.

    Attributes
    ----------
    name : str
        Channel and frequencies in words.
    channel, first, last : int
        The channel, and groups.
    least, most : float
        Its shares of A^2 at the holds at which it has the least and the most.
    theta, best, error : float
        Where its own amplitude is best, the logarithm of that, and its standard error.
    worse : float
        Factor by which it is worse where A is best, errors subtracted.
    """

    name: str
    channel: int
    first: int
    last: int
    least: float
    most: float
    theta: float = 0.0
    best: float = 0.0
    error: float = 0.0
    worse: float = 1.0

    @property
    def share(self) -> str:
        """Its share in words."""
        return f"{100.0 * self.least:.3g} to {100.0 * self.most:.3g} %"

    def describe(self) -> str:
        """Return its share and its own best in words."""
        worse = f", {self.worse:.3g} times worse where the sum is best" * (self.worse > 1.0)
        return f"{self.name}: {self.share}, best at {self.theta:.4g}{worse}"


@dataclass(frozen=True)
class Amplitude:
    """What is summed: see the module.

    Attributes
    ----------
    windows : Windows
        How samples are cut.
    weight : ndarray, shape (n, G)
        w_c / s_c^2 / sum w of each group; 0 where it does not react.
    background : float
        Weighted sum of F.
    floor : float
        Least A that can be told.
    seen : ndarray, shape (n, G)
        Most power of each group in a hold; infinite where that is not known.
    """

    windows: Windows
    weight: Array
    background: float
    floor: float
    seen: Array

    def squares(self, powers: Array) -> Array:
        """Return A^2 of windows, shape (W,), from their powers; below 0 where it is background."""
        return np.asarray(np.tensordot(powers, self.weight, axes=2) - self.background)

    def log(self, squares: Array) -> Array:
        """Return log A, not below the floor's."""
        return np.asarray(0.5 * np.log(np.maximum(squares, self.floor**2)))

    def most(self, log: float, least: float) -> float:
        """Return what A may be over another, of their logs: the floor may be background in both.

        Infinite if nothing of the other one need be left.
        """
        hidden = self.floor**2
        left = math.exp(2.0 * least) - hidden
        return math.sqrt(max(math.exp(2.0 * log) - hidden, 0.0) / left) if left > 0.0 else math.inf

    def new(self, powers: Array) -> tuple[float, float]:
        """Return what windows, of powers (W, n, G), have of what is not summed and was never seen.

        That is a mode that the holds were too short to let grow, or that they took for an
        interference that comes and goes: its part of A^2 and its frequency [Hz].
        """
        mean = powers.mean(axis=0)
        new = (self.weight == 0.0) & (mean > AMPLITUDE.falls * self.seen)
        new[:, : AMPLITUDE.lowest] = False
        parts = (self.weight.max(axis=1, keepdims=True) * mean * new).sum(axis=0)
        return float(parts.sum()), float(self.windows.frequency[parts.argmax()])

    def logs(self, x: Array) -> Array:
        """Return log A of each whole window of samples, shape (M, n)."""
        return self.log(self.squares(self.windows.powers(x)))

    def slower(self, x: Array) -> float:
        """Return A^2 of what windows are too short for, from samples, shape (M, n), of two or more.

        It is in their lowest bins, and in how their means differ from one to the next.
        """
        length = self.windows.length
        lowest = self.windows.powers(x)[:, :, : AMPLITUDE.lowest].sum(axis=2).mean(axis=0)
        parts = bridge_gaps(x[: x.shape[0] // length * length]).reshape(-1, length, x.shape[1])
        steps = np.diff(parts.mean(axis=1), axis=0)
        return float(self.weight.max(axis=1) @ (lowest + 0.5 * (steps**2).mean(axis=0))) + TINY

    def period(self, holds: Sequence[Array]) -> float:
        """Return the period [s] below which nearly all of A^2 is, in each of some holds.

        What only falls from the lowest frequencies on has none: a drift does so in windows of any
        length. It counts if there is nothing else. A hold without any power, where a coarse sensor
        reads one value, tells none.
        """
        shares = np.cumsum(self._parts(holds), axis=1)
        shares = shares[shares[:, -1] > 0.0]
        shares /= shares[:, -1:]
        first = int((shares > AMPLITUDE.slow).argmax(axis=1).min())
        return 1.0 / float(self.windows.frequency[first])

    def _parts(self, holds: Sequence[Array]) -> Array:
        """Return the part of A^2 in each group, without a drift, shape (holds, G)."""
        density = np.array([self.weight.max(axis=1) @ power for power in holds])
        density /= np.diff(np.array(self.windows.edges))
        rises = density > AMPLITUDE.falls * np.minimum.accumulate(density, axis=1)
        parts = np.array([(self.weight * power).sum(axis=0) for power in holds])
        beyond = parts * np.maximum.accumulate(rises, axis=1)
        return beyond if beyond.any() else parts

    def frequency(self, holds: Sequence[Array]) -> float:
        """Return the frequency [Hz] at which most of A^2 is, in some holds; not that of a drift."""
        parts = self._parts(holds).sum(axis=0)
        peak = int(parts.argmax())
        line = slice(max(peak - AMPLITUDE.lobe, 0), peak + AMPLITUDE.lobe + 1)
        return float(np.average(self.windows.frequency[line], weights=parts[line]))

    @property
    def ranges(self) -> list[tuple[int, int, int]]:
        """Channel, first group and last group of neighbours that react."""
        rows = []
        for channel, row in enumerate(self.weight > 0.0):
            steps = np.flatnonzero(np.diff(np.r_[False, row, False].astype(np.int8)))
            rows += [(channel, int(a), int(b) - 1) for a, b in steps.reshape(-1, 2)]
        return rows

    def modes(self, holds: Sequence[Array], channels: Sequence[str]) -> list[Mode]:
        """Return what reacts, without minor parts, from powers of holds, shape (W, n, G).

        A hold without any power, where a coarse sensor reads one value, has no shares.
        """
        parts = np.array([self.weight * power.mean(axis=0) for power in holds])
        totals = parts.sum(axis=(1, 2))
        parts = parts[totals > 0.0] / totals[totals > 0.0, None, None]
        rows = []
        for channel, first, last in self.ranges:
            name = f"{channels[channel]} at {self._spell_band(first, last)}"
            shares = parts[:, channel, first : last + 1].sum(axis=1)
            if shares.max() >= AMPLITUDE.minor:
                least, most = float(shares.min()), float(shares.max())
                rows.append(Mode(name, channel, first, last, least, most))
        return sorted(rows, key=lambda mode: -mode.most)

    def part(self, mode: Mode, powers: Array) -> Array:
        """Return what a mode has of A^2 in each window, shape (W,), with its background.

        As A itself it is not below the floor's.
        """
        groups = slice(mode.first, mode.last + 1)
        part = powers[:, mode.channel, groups] @ self.weight[mode.channel, groups]
        return np.maximum(part, self.floor**2)

    def name(self, channels: Sequence[str]) -> str:
        """Return in words what is summed."""
        parts: dict[str, list[str]] = {}
        for channel, first, last in self.ranges:
            parts.setdefault(channels[channel], []).append(self._spell_band(first, last))
        named: dict[str, list[str]] = {}  # channels that react alike are named together
        for channel_name, texts in parts.items():
            more = [f"{len(texts) - 3} more bands"] if len(texts) > 3 else []
            named.setdefault(", ".join([*texts[:3], *more]), []).append(channel_name)
        return " and ".join(f"{' and '.join(names)} at {text}" for text, names in named.items())

    def _spell_band(self, first: int, last: int) -> str:
        edges, seconds = self.windows.edges, self.windows.seconds
        low, high = edges[first] / seconds, (edges[last + 1] - 1) / seconds
        return f"{low:.3g} Hz" if low == high else f"{low:.3g} to {high:.3g} Hz"


def choose_amplitude(
    windows: Windows,
    holds: Sequence[Array],
    importance: Sequence[float] = (),
    places: Sequence[tuple[Array, int]] = (),
    hidden: Sequence[float] = (),
    beside: bool = False,
    unsteady: Callable[[int, int], Array] | None = None,
) -> Amplitude | None:
    """Choose what is summed, from the powers of holds once each had settled.

    Parameters
    ----------
    windows : Windows
        How samples are cut.
    holds : sequence of ndarray, shape (W, n, G)
        Powers of the windows of each hold, W at least 2.
    importance : sequence of float, optional
        w_c of each channel; alike unless given.
    places : sequence of (ndarray, int), optional
        Position of theta at each hold, shape (n,) for n knobs, NaN where it tells nothing, and the
        side it came from.
    hidden : sequence of float, optional
        Power that a sensor's step may hide in each channel, see :func:`find_hidden`.
    beside : bool
        Whether what is beside a quiet line counts: longer windows may tell it from that.
    unsteady : callable, optional
        See :func:`koop_tune.excitation.steady.unsteady_shares`, of a channel and a group.

    Returns
    -------
    Amplitude or None
        None if nothing reacts.
    """
    mean = np.array([hold.mean(axis=0) for hold in holds])
    mean = np.maximum(mean, TINY * mean.sum(axis=(0, 2), keepdims=True) / mean.shape[0] + 1e-300)
    # of a few windows a spread is small by chance: at least what most holds show
    spread = np.array([hold.std(axis=0) for hold in holds]) / mean
    spread = np.maximum(spread, np.quantile(spread, 0.5, axis=0, method="lower"))
    count = np.array([max(hold.shape[0] - 1, 1) for hold in holds])[:, None, None]
    error = np.minimum(spread * np.sqrt(2.0 / count), 2.0)  # neighbouring windows are alike
    doubt = AMPLITUDE.errors / math.sqrt(2.0) * error  # of two holds alike: errors of the change
    most = (mean * (1.0 + error)).min(axis=0)  # of a background; a short hold tells little
    reacts = _change(mean, doubt) > AMPLITUDE.change
    density = np.where(reacts, most, mean.mean(axis=0)) / np.diff(np.array(windows.edges))
    reacts[:, : AMPLITUDE.lowest] = False  # a window has too little of a slow interference
    repeats = _repeats(mean, error, places)
    left = reacts & (~repeats | _is_flank(mean, reacts & ~repeats))
    if not _is_most(mean, left, reacts & ~left):
        reacts &= repeats
    if not beside:
        reacts &= ~_is_beside_line(windows, mean, reacts)
    reacts &= _is_part(mean, reacts, AMPLITUDE.skirt)
    if unsteady is not None:
        reacts &= ~_is_steady(mean, reacts, unsteady)
    background = np.minimum(_beside(windows, density, reacts), most)
    unsure = AMPLITUDE.doubt * background
    for c, g in zip(*np.nonzero(reacts), strict=True):
        stays = mean[:, c, g] < mean[:, c, g].min() * math.exp(AMPLITUDE.change)
        if _change(mean[stays], doubt[stays])[reacts].max() > math.log(AMPLITUDE.falls):
            power = mean[stays, c, g]
            background[c, g] = min(float(power.mean()), most[c, g])
            unsure[c, g] = float(power.std()) / math.sqrt(power.size - 1)
    unsure = np.maximum(unsure, _find_beating(windows, mean, error, reacts))
    motion = np.maximum(mean - background, 0.0)
    size = (motion * reacts).sum(axis=2).max(axis=0)
    hides = (background * reacts).sum(axis=1)
    w = np.array(importance or [1.0] * size.size)
    counts = (size > 0.0) & (w > 0.0)
    if not counts.any():  # what differs at one place is then all that there is, as with hysteresis
        known = windows, holds, importance, (), hidden, beside
        return choose_amplitude(*known) if len(places) else None
    least = float((hides[counts] / size[counts]).min())
    use = counts & (hides < max(AMPLITUDE.hidden, least * 2.0) * size)
    w = np.where(use, w, 0.0)
    weight = reacts * (w / np.where(use, size, 1.0))[:, None] / w.sum()
    unseen = weight.max(axis=1) @ np.array(hidden or [0.0] * size.size)
    floor = math.sqrt(float((weight * unsure).sum() + unseen) + TINY)
    seen = mean.max(axis=0)
    return Amplitude(windows, weight, float((weight * background).sum()), floor, seen)


def whole_amplitude(windows: Windows, x: Array) -> Amplitude:
    """Return the amplitude of everything, from samples, shape (M, n): what reacts is unknown.

    A channel that stands still has no unit.
    """
    x = bridge_gaps(x)
    variance = x.var(axis=0)
    moves = variance > (TINY * np.abs(x).max(axis=0)) ** 2
    unit = np.where(moves, 1.0 / np.maximum(variance, 1e-300), 0.0)
    weight = np.repeat(unit[:, None], windows.frequency.size, axis=1) / variance.size
    return Amplitude(windows, weight, 0.0, math.sqrt(TINY), np.full(weight.shape, math.inf))


def _is_part(mean: Array, reacts: NDArray[np.bool_], skirt: float) -> NDArray[np.bool_]:
    """Return whether groups are more than the skirt of a stronger line, shape (n, G).

    They are so where they have most, or anywhere else while they fall: what is faint beside a
    strong mode at one end of the range may be all that is left where that is quiet.
    """
    strongest = (mean * reacts).max(axis=2, keepdims=True)
    part = mean > skirt * strongest
    falls = mean > AMPLITUDE.falls * mean.min(axis=0)  # noise does not
    at_most = np.take_along_axis(part, mean.argmax(axis=0)[None], axis=0)[0]
    return np.asarray(at_most | (part & falls).any(axis=0))


def _strongest_near(power: Array) -> Array:
    """Return the most power within the lobe of each group or bin; beyond the ends it is 0."""
    lobe, count = AMPLITUDE.lobe, power.shape[1]
    padded = np.pad(power, ((0, 0), (lobe, lobe)))
    return np.max([padded[:, i : i + count] for i in range(2 * lobe + 1)], axis=0)


def _is_flank(mean: Array, line: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return whether groups are less than a line beside them, both shape (n, G): what it leaks."""
    most = mean.max(axis=0)
    strongest = _strongest_near(most * line)
    return np.asarray(strongest > most)


def _is_beside_line(windows: Windows, mean: Array, reacts: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return whether groups are beside a quiet line that is about as strong, shape (n, G).

    What two lines leak into the bins between them beats with the time, and a slow one with its own
    phase: a few windows after one another see the same of it, the next hold sees other.
    """
    edges = np.array(windows.edges)
    quiet = np.repeat(np.where(reacts, 0.0, mean.min(axis=0)), np.diff(edges), axis=1)  # of a bin
    strongest = _strongest_near(quiet)
    strongest = np.maximum.reduceat(strongest, edges[:-1] - 1, axis=1)
    return np.asarray(reacts & (strongest > AMPLITUDE.line * mean.max(axis=0)))


def _is_steady(
    mean: Array, reacts: NDArray[np.bool_], unsteady: Callable[[int, int], Array]
) -> NDArray[np.bool_]:
    """Return whether groups are tones far weaker than what else reacts, shape (n, G).

    The strongest line is kept: theta may change how a rig responds to a tone. In most holds there
    is little but the tone, and in others what is with it is little beside the rest: a harmonic.
    """
    steady = np.zeros(reacts.shape, bool)
    strongest = (mean * reacts).max(axis=0)
    for c, g in zip(*np.nonzero(reacts & (strongest >= _strongest_near(strongest))), strict=True):
        line = slice(max(g - AMPLITUDE.lobe, 0), g + AMPLITUDE.lobe + 1)
        power = mean[:, c] * reacts[c]
        own = power[:, line].sum(axis=1)
        rest = power.sum(axis=1) - own
        if rest.max() > AMPLITUDE.falls * own.max():
            share = unsteady(c, g)
            tone, little = share < AMPLITUDE.unsteady, share * own < AMPLITUDE.skirt * rest
            steady[c, line] |= (tone | little).all() and 2 * tone.sum() > tone.size
    return steady


def _find_beating(windows: Windows, mean: Array, error: Array, reacts: NDArray[np.bool_]) -> Array:
    """Return the power that may be a line beside a harmonic, shape (n, G): it beats with that.

    A harmonic falls with its fundamental. What is about twice or three times as fast and is
    stronger where the fundamental is least than at another hold, but never far less, may be a line
    that theta does not change, alone where the harmonic is gone, and less where it met that out of
    phase. A mode of its own that becomes worse is far less elsewhere.
    """
    edges = np.array(windows.edges)
    first, last, level = edges[:-1], edges[1:] - 1, np.log(mean)
    strongest = (mean * reacts).max(axis=0)
    peak = strongest >= _strongest_near(strongest)
    result = np.zeros(reacts.shape)
    for c, g in zip(*np.nonzero(reacts & peak), strict=True):
        least = int(level[:, c, g].argmin())
        rise, errors = level[:, c] - level[least, c], np.hypot(error[:, c], error[least, c])
        falls = rise[:, g] - errors[:, g] > math.log(AMPLITUDE.falls)
        stronger = (falls[:, None] & (-rise - errors > AMPLITUDE.change)).any(axis=0)
        stronger &= rise.min(axis=0) > -math.log(AMPLITUDE.falls)
        for k in AMPLITUDE.harmonics:
            beside = (first <= k * (last[g] + 0.5)) & (last >= k * (first[g] - 0.5))
            beats = stronger & beside & reacts[c]  # then in every channel
            result = np.maximum(result, mean[least] * (reacts & beats))
    return result


def _change(mean: Array, doubt: Array) -> Array:
    """Return by how much log powers of holds differ beyond doubt, both (H, n, G): shape (n, G)."""
    level = np.log(mean)
    return np.asarray((level - doubt).max(axis=0) - (level + doubt).min(axis=0))


def _repeats(mean: Array, error: Array, places: Sequence[tuple[Array, int]]) -> NDArray[np.bool_]:
    """Return whether groups have about the same power where theta is the same, shape (n, G).

    An interference that comes and goes differs as much there as over the whole range, and as much
    from one place to the next: at most places at which theta was again, and more than one. A rig
    that has two states at a theta, at rest and oscillating, differs there alone. An oscillation
    that noise drives, or that answers slowly, may differ at a place, too, but less from place to
    place: by less than von Neumann's ratio of M values without order, 1 with a deviation of
    1 / sqrt(M) (Annals of Mathematical Statistics 12 (1941) 367-395). With hysteresis only holds
    that theta came to from the same side are alike.
    """
    at, level = np.array([[*u, side] for u, side in places]), np.log(mean)
    if not at.size:
        return np.ones(mean.shape[1:], bool)
    apart = np.abs(at[:, None] - at).max(axis=2)
    first, again = np.nonzero(np.triu(apart < AMPLITUDE.same, 1))
    beyond = np.where(apart >= AMPLITUDE.same, apart, math.inf)  # NaN is not
    moved, nearest = np.isfinite(beyond).any(axis=1), beyond.argmin(axis=1)
    if first.size < AMPLITUDE.pairs or not moved.any():
        return np.ones(mean.shape[1:], bool)

    def differs(
        a: NDArray[np.intp], b: NDArray[np.intp], share: float = AMPLITUDE.comes
    ) -> NDArray[np.bool_]:
        squares = (level[a] - level[b]) ** 2 - error[a] ** 2 - error[b] ** 2
        return np.asarray(0.5 * squares.mean(axis=0) >= share * level.var(axis=0))

    place = (apart < AMPLITUDE.same).argmax(axis=1)[first]  # the first hold there
    there = np.array([differs(first[place == k], again[place == k]) for k in np.unique(place)])
    often = (there.sum(axis=0) > 1) & (2 * there.sum(axis=0) >= there.shape[0])
    ratio = max(AMPLITUDE.comes, 1.0 - AMPLITUDE.ordered / math.sqrt(moved.sum()))
    return ~(often & differs(np.flatnonzero(moved), nearest[moved], ratio))


def _is_most(mean: Array, part: NDArray[np.bool_], rest: NDArray[np.bool_]) -> bool:
    """Return whether a part of the groups, shape (n, G), is by far the most of what moves.

    Then a rig may have two oscillations at one theta, whose choice depends on the way there.
    """
    most, less = ((mean * groups).sum(axis=2).max(axis=0) for groups in (part, rest))
    shares = [a / (a + b) for a, b in zip(most, less, strict=True) if a + b > 0.0]
    return sum(shares) > AMPLITUDE.nearly_all * max(len(shares), 1)


def _beside(windows: Windows, density: Array, reacts: NDArray[np.bool_]) -> Array:
    """Return F, shape (n, G): the density of the quietest of the quiet groups beside.

    Not of most of them: lines of interference are quiet groups too, and reach over several.
    """
    width = np.diff(np.array(windows.edges))
    result = np.zeros(reacts.shape)
    for c, g in zip(*np.nonzero(reacts), strict=True):
        quiet = np.flatnonzero(~reacts[c])
        beside = np.r_[quiet[quiet < g][-AMPLITUDE.beside :], quiet[quiet > g][: AMPLITUDE.beside]]
        result[c, g] = density[c, beside].min(initial=math.inf if beside.size else 0.0) * width[g]
    return result


def find_step(x: Array) -> Array:
    """Return the step of each channel's sensor, from samples, shape (M, n): shape (n,).

    Infinite where it is finer than what was seen, or nothing moved.
    """
    steps = np.full(x.shape[1], math.inf)
    for j, column in enumerate(x.T):
        values, counts = np.unique(column[np.isfinite(column)], return_counts=True)
        # a stop repeats one value without the others being steps
        if 1 < values.size < AMPLITUDE.repeated * (column.size - counts.max()):
            between = np.diff(values)
            steps[j] = between[between > 1e-9 * np.ptp(values)].min()
    return steps


def find_hidden(steps: Sequence[Array], deviations: Sequence[Array]) -> list[float]:
    """Return the power that a sensor's step may hide in each channel.

    Parameters
    ----------
    steps, deviations : sequence of ndarray, shape (n,)
        Step and standard deviation of each hold. What moves by more than a step is carried over it.
    """
    step = np.min(steps, axis=0)
    stood = np.isfinite(step) & (np.min(deviations, axis=0) < step)
    return np.where(stood, step**2 / 8.0, 0.0).tolist()


def bridge_gaps(x: Array) -> Array:
    """Return samples, shape (M, n), with those that are not finite taken from their neighbours."""
    if np.isfinite(x).all():
        return x
    places, result = np.arange(x.shape[0]), x.copy()
    for j in range(x.shape[1]):
        finite = np.isfinite(x[:, j])
        result[:, j] = np.interp(places, places[finite], x[finite, j]) if finite.any() else 0.0
    return result


def _detrended(x: Array) -> Array:
    """Return windows, shape (W, n, length), less their straight line."""
    t = np.linspace(-1.0, 1.0, x.shape[2])
    centred = x - x.mean(axis=2, keepdims=True)
    return np.asarray(centred - (centred @ t / (t @ t))[:, :, None] * t)


def window_length(period: float, periods: float, dt: float) -> int:
    """Return the samples of a window of some periods; at least 64."""
    return max(64, math.ceil(periods * period / dt))
