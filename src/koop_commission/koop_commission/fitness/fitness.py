"""Whether a rig is fit to be commissioned, judged by its samples. Pure: arrays in, findings out."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_commission.fitness.arrivals import Rhythm, measure_rhythm
from koop_commission.fitness.reaction import Reaction, describe_change
from koop_commission.fitness.samples import Samples
from koop_commission.fitness.settings import DEFAULTS
from koop_core.errors import InputError
from koop_tune.excitation.amplitude import Windows, bridge_gaps
from koop_tune.excitation.channels import ChannelSummary, Line, describe_channel, find_lines
from koop_tune.rig.rig_file import RigFile

OK, NOTE, BAD = "ok", "note", "BAD"
COUNTED = {
    "steps": "counted by steps",
    "stamps": "counted by stamps",
    "arrival": "no stamps: counted by arrival at the dt of the rig file",
}


class Finding(NamedTuple):
    """A line of the check: ``ok``, ``note`` or ``BAD``, what it is about, and what was found."""

    level: str
    name: str
    text: str

    def __str__(self) -> str:
        return f"{self.level:<4}  {self.name:<10}  {self.text}"


def judge_samples(rig: RigFile, samples: Samples, pace: float) -> Iterator[Finding]:
    """Yield the findings that need no command: arrival, channels, spectra.

    ``pace`` is the seconds of the rig's own time per second.
    """
    try:
        rhythm = measure_rhythm(samples, rig.dt, pace)
    except InputError as error:
        yield Finding(BAD, "arrival", str(error))
        return
    yield judge_arrivals(rig.dt, rhythm, pace)
    low = rig.channel_min or (-math.inf,) * len(rig.names)
    high = rig.channel_max or (math.inf,) * len(rig.names)
    for name, x, least, most in zip(rig.names, samples.x.T, low, high, strict=True):
        yield judge_channel(name, describe_channel(x), (least, most))
    for name, x in zip(rig.names, samples.x.T, strict=True):
        if peaks := find_lines(x, rig.dt):
            yield describe_lines(name, peaks)


def judge_arrivals(dt: float, rhythm: Rhythm, pace: float) -> Finding:
    """Judge rate and losses of the messages."""
    lost = f"lost {rhythm.lost or 'none'}" + f" ({100.0 * rhythm.share:.2g} %)" * bool(rhythm.lost)
    text = (
        f"{rhythm.received} messages, {rhythm.rate:.4g} a second, "
        f"jitter {1e3 * rhythm.jitter:.2g} ms, {lost}, {COUNTED[rhythm.source]}"
    )
    if abs(rhythm.interval / dt - 1.0) > DEFAULTS.near:
        cause = "dt is wrong, or pace" + ", or messages are lost" * (rhythm.interval > dt)
        if rhythm.source == "stamps" and pace != 1.0:
            cause += ", or the stamps do not count the rig's own time"
        per = " of the rig's time" * (pace != 1.0)
        text = f"a message every {rhythm.interval:.4g} s{per}, but dt = {dt:g}: {cause}; {text}"
        return Finding(BAD, "arrival", text)
    if rhythm.share > DEFAULTS.lost_badly:
        return Finding(BAD, "arrival", f"{text}: too many")
    late = 2.0 * rhythm.jitter * rhythm.rate / rhythm.received  # a burst at an end shifts the count
    off = min(abs(rate * dt / pace - 1.0) for rate in (rhythm.rate, rhythm.steady))
    if not rhythm.lost and off > DEFAULTS.slow + late:
        # steps and stamps confirm dt; a simulated rig may be slower than its pace says
        far = off > DEFAULTS.near
        hint = " (is it simulated? set 'pace' in the rig file)" * far
        text = f"{text}; expected {pace / dt:.4g} a second of dt = {dt:g} s{hint}"
        return Finding(BAD if far or rhythm.source == "arrival" else NOTE, "arrival", text)
    return Finding(NOTE if rhythm.share > DEFAULTS.lost else OK, "arrival", text)


def judge_channel(
    name: str,
    summary: ChannelSummary,
    limits: tuple[float, float] = (-math.inf, math.inf),
) -> Finding:
    """Judge the values of one channel; ``limits`` come from the rig file."""
    low, high = limits
    span = f"{name} {summary.low:.6g} to {summary.high:.6g}"
    if summary.bad == 1.0:
        return Finding(BAD, "channel", f"{name} is never a number: dead sensor, or another field")
    if summary.bad:
        text = f"{100 * summary.bad:.3g} % of {name} are not finite: the guard trips at the first"
        return Finding(BAD, "channel", text)
    if summary.dead:
        text = f"{name} is always {summary.low:g}: dead sensor, or to be left out of 'measured'"
        return Finding(BAD, "channel", text)
    if summary.low < low or summary.high > high:
        limit = low if summary.low < low else high
        text = f"{span}, beyond its limit {limit:g} before theta moves"
        return Finding(BAD, "channel", text)
    rests = f"rests at one value for {100 * summary.held:.0f} % of the time"
    if summary.held > DEFAULTS.stuck:
        return Finding(BAD, "channel", f"{name} {rests}: stuck")
    text = f"{span}, standard deviation {summary.deviation:.3g}"
    if summary.quantum:
        text += f", resolution {summary.quantum:.3g}"
    notes = []
    if summary.held > DEFAULTS.stuck / 5.0:
        notes.append(rests)
    if summary.saturated:
        notes.append(f"saturated for {100 * summary.saturated:.3g} % of the time")
    if summary.quantum > DEFAULTS.coarse * summary.deviation:
        notes.append("coarse: the resolution is a good part of the deviation")
    return Finding(NOTE if notes else OK, "channel", "; ".join([text, *notes]))


def describe_lines(name: str, peaks: Sequence[Line]) -> Finding:
    """Name the lines in the spectrum of one channel."""
    first, *others = [f"{p.frequency:.3g} Hz (amplitude {p.amplitude:.3g})" for p in peaks]
    text = f"{name} strongest at {first}"
    if others:
        text += (
            f", also at {', '.join(others)}: 'koop excite' finds which of them theta changes; the "
            "others are interference and do not count"
        )
    return Finding(OK, "spectrum", text)


def judge_reaction(reaction: Reaction, names: Sequence[str], between: str) -> Finding:
    """Judge whether theta reaches the rig; ``between`` are its values, in words."""
    if reaction.p > max(DEFAULTS.p, DEFAULTS.p_more):
        why = (
            "the command is not applied, or theta has no effect there: see that the rig takes it, "
            "or choose another theta_start (with a constraint: theta_safe)"
        )
        return Finding(BAD, "theta", f"{between}: nothing reacts (p = {reaction.p:.2f}): {why}")
    name, change = names[reaction.feature], reaction.change
    how = f"moves by {change:.3g}" if name.startswith("mean") else describe_change(change)
    confidence = f"reaches the rig with {100 * reaction.confidence:.3g} % confidence"
    return Finding(OK, "theta", f"{confidence}; {between}: {name} {how}")


class Blocks(NamedTuple):
    """How blocks of samples are looked at: as one window, its groups of frequencies in few bands.

    ``starts`` are the first group of each band, and the one beyond the last.
    """

    windows: Windows
    starts: tuple[int, ...]

    @classmethod
    def choose(cls, x: NDArray[np.float64], windows: Windows) -> Blocks:
        """Choose bands that hold nearly all of the power of samples, shape (M, n)."""
        short = windows._replace(length=min(windows.length, x.shape[0]))
        power = short.powers(x).mean(axis=0)
        share = np.cumsum(
            (power / np.maximum(power.sum(axis=1, keepdims=True), 1e-300)).sum(axis=0)
        )
        top = short.frequency[int(np.searchsorted(share, DEFAULTS.power * share[-1]))]
        count = int(np.searchsorted(windows.frequency, top)) + 1
        starts = np.unique(np.round(np.linspace(0, count, DEFAULTS.bands + 1)).astype(int))
        return cls(windows, tuple(int(start) for start in starts))

    def features(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the log amplitude in each band of each channel of a block, and each mean."""
        power = self.windows.powers(x)[0]
        bands = np.add.reduceat(power, self.starts[:-1], axis=1)
        return np.r_[0.5 * np.log(bands + 1e-24).ravel(), bridge_gaps(x).mean(axis=0)]

    def names(self, channels: Sequence[str]) -> list[str]:
        """Return the name of each feature."""
        edges = np.array(self.windows.edges) / self.windows.seconds
        spans = [(f"{edges[a]:.3g}", f"{edges[b]:.3g}") for a, b in itertools.pairwise(self.starts)]
        bands = [
            f"amplitude of {name} between {low} and {high} Hz"
            for name in channels
            for low, high in spans
        ]
        return [*bands, *(f"mean {name}" for name in channels)]


def choose_period(rig: RigFile, samples: Samples) -> float:
    """Return the period to wait by [s]: of the strongest oscillation, or half of the slowest."""
    every = [line for x in samples.x.T for line in find_lines(x, rig.dt)]
    if not every:
        return DEFAULTS.blind * rig.dt
    strongest = max(every, key=lambda line: line.share).frequency
    return max(1.0 / strongest, 0.5 / min(line.frequency for line in every))
