"""A measured closed loop: what was predicted of it, and whether it damped the rig.

The amplitude is the excitation's (:mod:`koop_tune.excitation.amplitude`), in the same windows. A
loop is damped if, over its second half, which is at least as long as an oscillation was seen to
need to grow,

- the amplitude is within 1.5 of the best of the final map and of its best hold, of the loops
  and the holds after them, and of the best that an earlier round knew; so it is once theta rests;
- nothing that is not summed moves far more than in any hold of the excitation;
- all of theta's swing lies in the valley of that map, or in what the loop itself showed to be as
  good where it went beyond;
- from the worst start, where it was more than 1.5 times the best beyond its error, the amplitude
  fell, and over all starts by more than its error explains.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.config.knobs import format_knobs
from koop_tune.excitation.amplitude import Amplitude, Mode
from koop_tune.excitation.holds import mean_level
from koop_tune.excitation.static_map import times_best
from koop_tune.rig.scale import Scale
from koop_tune.rig_model.surrogate import BLOCKS
from koop_tune.search.prediction import Prediction
from koop_tune.search.settings import CONVERGENCE, VERIFICATION, VerificationSettings

Array = NDArray[np.float64]
LITTLE = (
    "theta changes the amplitude little: at no start was it surely worse than the best by a "
    f"factor of {CONVERGENCE.good:g}"
)


class KnobAim(NamedTuple):
    """What is expected of a knob: its best theta, and the valley around it.

    Attributes
    ----------
    scale : Scale
        Theta's range.
    theta : float
        The best theta.
    valley : tuple of float
        Thetas between which the map is within 1.5 of the best.
    """

    scale: Scale
    theta: float
    valley: tuple[float, float]


@dataclass(frozen=True)
class Aim:
    """Results that a tuning expects of a rig.

    Attributes
    ----------
    amplitude : Amplitude
        What is summed.
    name : str
        It in words.
    knobs : tuple of KnobAim
        Each knob.
    sense : float
        +1 if little is wanted, else -1.
    best, error, bound : float
        Logarithm of the best amplitude, by how much a better one may be, and that at which a loop
        counts as converged.
    time, growth : float
        The rig's own time, and the longest that its oscillation was seen to grow [s].
    predicted : Prediction
        The tuning's.
    modes : tuple of Mode
        Parts of the amplitude, with the best of each alone.
    settings : VerificationSettings
        How a loop is compared with it.
    longer : float
        Times that a loop is closed as long as these ask for: earlier ones left a doubt.
    known : float
        y of the best amplitude of any hold, or of what earlier rounds knew, its error on top;
        infinite without any.
    """

    amplitude: Amplitude
    name: str
    knobs: tuple[KnobAim, ...]
    sense: float
    best: float
    error: float
    bound: float
    time: float
    growth: float
    predicted: Prediction
    modes: tuple[Mode, ...] = ()
    settings: VerificationSettings = VERIFICATION
    longer: float = 1.0
    known: float = math.inf

    @property
    def y(self) -> float:
        """Value y of the best amplitude, its error on top."""
        return self.sense * self.best + self.error

    @property
    def theta(self) -> str:
        """The best theta of each knob, in words."""
        return spell([knob.theta for knob in self.knobs])

    @property
    def window(self) -> float:
        """Length of a window [s]."""
        return self.amplitude.windows.seconds

    @property
    def longest(self) -> float:
        """Longest duration of a closed loop [s]; the figures describe its second half."""
        return self.longer * max(self.predicted.duration, 2.0 * self.growth)

    @property
    def duration(self) -> float:
        """Shortest duration of a closed loop that can confirm the prediction [s]."""
        whole, late = self.longest, self.predicted.converges.high
        least = max(self.settings.least * self.predicted.duration, 2.0 * self.growth)
        return min(self.longer * max(self.settings.twice * late, least), whole)


@dataclass(frozen=True)
class Measured:
    """Measured figures of one closed loop.

    Attributes
    ----------
    time_to_converge : float or None
        [s]; None if never.
    distance : float
        Mean of abs(u - u*) over the second half, in ranges of theta; of the knob with the largest.
    amplitude_before, amplitude : float
        Before the loop was closed, and over the second half.
    error, doubt : float
        Standard errors of the logarithms of their ratio and of ``amplitude``.
    excess : float
        Amplitude over the best one (its inverse where it is to be large).
    reduction : float
        Amplitude before over the amplitude in the second half (its inverse).
    theta, low, high : tuple of float
        Mean of theta of each knob over the second half, and its least and largest.
    broken : float
        Share of the second half in which a constraint was broken.
    modes : tuple of float
        Factors by which the aim's modes are worse than each at its own best, errors subtracted.
    beyond : float or None
        Amplitude in the windows of the second half in which theta was not in the valley all the
        time; None if there were fewer than two.
    beyond_doubt : float
        Standard error of its logarithm.
    new, new_at : float
        Amplitude of what the excitation never showed, and its frequency [Hz].
    held : float or None
        Amplitude once theta was held at its mean, after the loop; None until then.
    held_doubt : float
        Standard error of its logarithm.
    """

    time_to_converge: float | None
    distance: float
    amplitude_before: float
    amplitude: float
    error: float
    doubt: float
    excess: float
    reduction: float
    theta: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    broken: float = 0.0
    modes: tuple[float, ...] = ()
    beyond: float | None = None
    beyond_doubt: float = 0.0
    new: float = 0.0
    new_at: float = 0.0
    held: float | None = None
    held_doubt: float = 0.0

    @property
    def swing(self) -> tuple[float, ...]:
        """Range of theta of each knob over the second half."""
        return tuple(high - low for low, high in zip(self.low, self.high, strict=True))


def measure(aim: Aim, before: Array, x: Array, theta: Array) -> Measured:
    """Measure a run.

    Parameters
    ----------
    aim : Aim
        What it should come to.
    before : ndarray, shape (B, n)
        Measured channels once the rig had settled where the loop began.
    x : ndarray, shape (M, n)
        Measured channels with the loop closed.
    theta : ndarray, shape (K,) or (K, n)
        Its theta, of one knob or of n, evenly over the same time.
    """
    paths = [np.ascontiguousarray(path[path.size // 2 :]) for path in np.atleast_2d(theta.T)]
    amplitude = aim.amplitude
    powers = amplitude.windows.powers(x)
    squares, first = map(amplitude.squares, (powers, amplitude.windows.powers(before)))
    half = squares.size // 2
    late = squares[half:]
    level, error = mean_level(late, amplitude.floor)
    if late.size >= 4:
        (early, a), (last, b) = (mean_level(h, amplitude.floor) for h in np.array_split(late, 2))
        if abs(last - early) > aim.settings.errors * math.hypot(a, b):  # it grows, or falls yet
            level = max(early, last, key=lambda v: aim.sense * v)
    began, error_before = mean_level(first, amplitude.floor)
    k = min(max(aim.settings.smoothed, math.ceil(squares.size / BLOCKS)), squares.size)
    smooth = np.asarray(np.convolve(squares, np.ones(k) / k, "valid"), np.float64)
    inside = np.flatnonzero(aim.sense * (amplitude.log(smooth) - aim.bound) <= 0.0)
    errors = [min(value, aim.settings.unknown) for value in (error, error_before)]
    u = [knob.scale.u(path) for knob, path in zip(aim.knobs, paths, strict=True)]
    best = [knob.scale.u(np.array(knob.theta)) for knob in aim.knobs]
    whole = squares.size * amplitude.windows.length / x.shape[0]  # the last one may be cut
    path = theta[: round(whole * theta.shape[0])]
    out = late[_is_beyond(aim, path, squares.size)[half:]]
    beyond, error_beyond = mean_level(out, amplitude.floor) if out.size > 1 else (None, 0.0)
    new, new_at = amplitude.new(powers[half:])
    return Measured(
        (int(inside[0]) + k) * aim.window if inside.size else None,
        max(float(np.abs(each - at).mean()) for each, at in zip(u, best, strict=True)),
        math.exp(began),
        math.exp(level),
        math.hypot(*errors),
        errors[0],
        math.exp(aim.sense * (level - aim.best)),
        math.exp(aim.sense * (began - level)),
        tuple(k.scale.theta_at(float(v.mean())) for k, v in zip(aim.knobs, u, strict=True)),
        tuple(float(path.min()) for path in paths),
        tuple(float(path.max()) for path in paths),
        modes=tuple(_find_worse(aim, mode, powers[half:]) for mode in aim.modes),
        beyond=None if beyond is None else math.exp(beyond),
        beyond_doubt=error_beyond,
        new=math.sqrt(new),
        new_at=new_at,
    )


def with_hold(aim: Aim, run: Measured, x: Array) -> Measured:
    """Return a run with the amplitude after it, of channels, shape (B, n), with theta held."""
    squares = aim.amplitude.squares(aim.amplitude.windows.powers(x))
    level, doubt = mean_level(squares, aim.amplitude.floor)
    return replace(run, held=math.exp(level), held_doubt=min(doubt, aim.settings.unknown))


def _is_beyond(aim: Aim, theta: Array, count: int) -> NDArray[np.bool_]:
    """Return in which of some windows theta, shape (K,) or (K, n), was not in the valley."""
    outside = np.zeros(theta.shape[0], bool)
    for knob, path in zip(aim.knobs, np.atleast_2d(theta.T), strict=True):
        outside |= ~_is_inside(knob, path, path)
    return np.array([part.any() for part in np.array_split(outside, count)])


def _find_worse(aim: Aim, mode: Mode, powers: Array) -> float:
    """Return by what factor a mode is worse than at its own best, errors subtracted; at least 1."""
    level, error = mean_level(aim.amplitude.part(mode, powers))
    doubt = aim.settings.errors * math.hypot(error, mode.error)
    return math.exp(max(aim.sense * (level - mode.best) - doubt, 0.0))


def find_disagreements(aim: Aim, run: Measured, allowance: float = 1.0) -> list[str]:
    """Return the figures that are worse than predicted, in words.

    A prediction that allows almost anything is not confirmed by anything. The bands are widened by
    a share of the allowance for errors of the measurement; 0: what lies outside of the bands. The
    time to converge is measured as the end of a mean of some windows.
    """
    p, s, worse = aim.predicted, aim.settings, []
    widened = math.exp(allowance * s.errors * run.error)
    late, took = p.converges.high, run.time_to_converge
    limit = (1.0 + allowance * (s.later - 1.0)) * late + s.smoothed * aim.window
    if (math.inf if took is None else took) > limit:
        outcome = "did not converge" if took is None else f"took {took:.4g} s to converge"
        worse.append(f"{outcome}, at most {late:.4g} s were predicted")
    if run.excess > p.excess.high * widened:
        most = p.excess.high
        band = f"at most {most:.3g} were" if aim.sense > 0 else f"at least 1/{most:.3g} was"
        worse.append(f"ended at {times_best(run.excess, aim.sense)} amplitude, {band} predicted")
    if run.reduction < p.reduction.low / widened:
        worse.append(
            f"changed the amplitude by a factor of {run.reduction:.3g}, at least "
            f"{p.reduction.low:.3g} was predicted"
        )
    return worse


def find_faults(aim: Aim, runs: Sequence[Measured]) -> list[str]:
    """Return why the rig is not damped by the loops from all starts, in words; empty if it is.

    A single loop, before the others, is not asked whether it makes the amplitude fall.
    """
    faults, good = [], CONVERGENCE.good
    limit = f"{good:g} is the most" if aim.sense > 0 else f"1/{good:g} the least"
    final, _ = _find_best(aim, runs)

    def most(amplitude: float, *doubts: float) -> float:
        worse = math.log(amplitude) + aim.sense * aim.settings.sure * math.hypot(*doubts)
        return aim.amplitude.most(*((worse, final) if aim.sense > 0 else (-final, worse)))

    for run in runs:
        whole = _whole(aim, run)
        excess = most(whole, run.doubt, aim.error)
        rested = 0.0 if run.held is None else most(run.held)
        beyond = math.inf
        if run.beyond is not None:
            beyond = most(run.beyond, run.beyond_doubt, aim.error)
        if _is_new(aim, run):
            faults.append(
                f"near theta = {spell(run.theta)} the rig moves at about {run.new_at:.3g} Hz as it "
                f"never did in the excitation: with it the amplitude is {whole:.3g}, without "
                f"{run.amplitude:.3g}"
            )
        elif math.isinf(excess):
            faults.append(
                f"near theta = {spell(run.theta)} background or sensor hides what is left: of an "
                f"amplitude below {aim.amplitude.floor:.2g} nothing can be told"
            )
        elif excess > good:
            faults.append(
                f"near theta = {spell(run.theta)} the amplitude may within its error be "
                f"{times_best(excess, aim.sense)} known, {limit}"
            )
        elif rested > good:
            faults.append(
                f"once theta rested at {spell(run.theta)} the amplitude was "
                f"{times_best(rested, aim.sense)} known, {limit}"
            )
        elif beyond > good and not all(map(_is_inside, aim.knobs, run.low, run.high)):
            low, high = (spell([knob.valley[end] for knob in aim.knobs]) for end in (0, 1))
            faults.append(
                f"theta swings from {spell(run.low)} to {spell(run.high)}, the valley reaches from "
                f"{low} to {high}"
            )
    faults += [
        f"near theta = {spell(run.theta)} the constraint is broken for {100.0 * run.broken:.3g} % "
        f"of the time, {100.0 * aim.settings.broken:g} % is the most"
        for run in runs if run.broken > aim.settings.broken
    ]  # fmt: skip
    if len(runs) > 1 and max(_least_before(aim, run) for run in runs) <= good:
        faults.append(LITTLE)
    # of all starts together, as one of them may have begun at the best and one falls by chance
    gain, error = sum(math.log(run.reduction) for run in runs), math.hypot(*(r.error for r in runs))
    if len(runs) > 1 and gain <= aim.settings.errors * error:
        verb = "fall" if aim.sense > 0 else "rise"
        faults.append(f"over all starts the amplitude does not {verb} by more than its error")
    for run in runs:
        if math.log(run.reduction) < -aim.settings.errors * run.error - math.log(good):
            faults.append(f"the amplitude is worse than before by {1.0 / run.reduction:.3g}")
    return faults


def _find_best(aim: Aim, runs: Sequence[Measured]) -> tuple[float, str]:
    """Return y of the best of the final map, and where that is, in words.

    The loops belong to that map, the holds after them, and what earlier rounds knew.
    """
    found = [(min(aim.sense * aim.best, aim.known), f"{aim.theta}, the best of the map")]
    for run in runs:
        for amplitude, doubt in ((run.amplitude, run.doubt), (run.held, run.held_doubt)):
            if amplitude is not None:
                y = aim.sense * math.log(amplitude) + doubt
                found.append((y, f"{spell(run.theta)}, the best known ({amplitude:.3g})"))
    return min(found)


def _least_before(aim: Aim, run: Measured) -> float:
    """Return the amplitude over the best before the loop was closed, or less by its error."""
    doubt = aim.settings.sure * math.hypot(run.error, aim.error)
    return run.excess * run.reduction * math.exp(-doubt)


def _whole(aim: Aim, run: Measured) -> float:
    """Return the amplitude with what is new, where little is wanted."""
    return math.hypot(run.amplitude, run.new) if aim.sense > 0 else run.amplitude


def _is_new(aim: Aim, run: Measured) -> bool:
    """Return whether most of what moves is new."""
    return _whole(aim, run) > CONVERGENCE.good * max(run.amplitude, math.exp(aim.best))


def _is_inside(knob: KnobAim, low: Array | float, high: Array | float) -> NDArray[np.bool_]:
    """Return whether a knob swings in its valley, or hardly beyond."""
    slack = 0.02 * (knob.valley[1] - knob.valley[0])
    inside = (knob.valley[0] - slack <= low) & (high <= knob.valley[1] + slack)
    return np.asarray(inside)


def spell(theta: Sequence[float]) -> str:
    """Return theta of each knob in words."""
    return format_knobs(theta, ".4g")


def spell_goal(sense: float) -> str:
    """Return in words what a rig is whose loops are good; ``sense`` is +1 if little is wanted."""
    return "damped" if sense > 0.0 else "at its strongest oscillation"


def name_gains(sense: float) -> tuple[str, str]:
    """Return what the excess and the reduction of a loop are called."""
    if sense > 0.0:
        return "amplitude over the best", "reduction, a factor of"
    return "best over the amplitude", "growth, a factor of"


def verdict(aim: Aim, runs: Sequence[Measured], rounds: int, where: str) -> str:
    """Return the verdict of a verification in a few lines: the answer, of what, and at what price.

    Parameters
    ----------
    aim : Aim
        What was predicted.
    runs : sequence of Measured
        Runs of the last round.
    rounds : int
        How many rounds there were.
    where : str
        Folder that ``koop up`` runs.
    """
    faults, goal = find_faults(aim, runs), spell_goal(aim.sense)
    worse = [text for run in runs for text in find_disagreements(aim, run)]
    if faults:
        advice = f"leave theta at {_find_best(aim, runs)[1]}, or " + (
            "widen its limits" if faults[0] == LITTLE else
            "set theta_min and theta_max closer around it and choose another --out"
        )  # fmt: skip
        if any(_is_new(aim, run) for run in runs):
            advice = "the map lacks that: leave theta at theta_safe"
        answer = (
            f"The rig is not {goal} after {rounds} round{'s' * (rounds != 1)}: {faults[0]}; "
            f"{advice}"
        )
    elif worse:
        answer = f"The rig is {goal}, but not as predicted ({worse[0]}): ./koop up {where} runs it"
    else:
        outside = {text: None for run in runs for text in find_disagreements(aim, run, 0.0)}
        band = f", within the errors of measurement ({'; '.join(outside)})" if outside else ""
        answer = f"The rig is {goal} as predicted{band}: ./koop up {where} runs it"
    lines = [answer, f"The amplitude is that of {aim.name}"]
    if not faults and (trade := _describe_trade(aim, runs)):
        lines.append(trade)
    return "\n".join(f"{line}." for line in lines)


def _describe_trade(aim: Aim, runs: Sequence[Measured]) -> str:
    """Return which modes are far from their own best, in words; empty if all are near."""
    rows = zip(aim.modes, *(run.modes for run in runs), strict=True)
    far = sorted([(max(each), mode) for mode, *each in rows if max(each) > CONVERGENCE.good])
    if not far:
        return ""
    parts = [
        f"{mode.name} ({mode.share} of its square) by a factor of {worse:.3g}"
        + f" at theta = {mode.theta:.4g}" * (len(aim.knobs) == 1)
        for worse, mode in far[:-4:-1]
    ]
    several = len({mode.channel for mode in aim.modes}) > 1
    return (
        f"The best sum is not the best of each part: better alone is {', '.join(parts)}"
        + "; 'weights' in the rig file ask for another sum" * several
    )
