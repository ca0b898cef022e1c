"""From an excitation to a cost with all its constants, or why there are none. Pure: no ROS."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.errors import InputError
from koop_identify.model.compare import Cost, costs
from koop_identify.model.from_bags import BagTraining
from koop_identify.model.windows import period_of
from koop_identify.recording.loaded import Loaded
from koop_tune.excitation import optimum_test
from koop_tune.excitation.features import Bands, bands, window_length
from koop_tune.excitation.optimum_test import SURE
from koop_tune.excitation.staircase import level
from koop_tune.rig.rig_file import RigFile
from koop_tune.rig_model.static_map import GRID, StaticMap, static_map, weights_of
from koop_tune.rig_model.stays import Scale, Stays, find_stays, period_by_theta, window_levels
from koop_tune.rig_model.surrogate import Surrogate, Times, fit_times, high_passed
from koop_tune.search.prediction import Band, Prediction
from koop_tune.search.search import (
    GOOD,
    HIGH,
    LENGTH,
    Outcome,
    Task,
    Tried,
    confirm,
    search,
    try_out,
)

PERIODS = 4.0  # of the oscillation, in a window
SURROGATES = 6
UNSURE = 0.35  # standard deviation of the logarithm of tau
SLIGHT = 0.1  # of the amplitude: whoever sees no optimum in less sees none
DECIDES, NEAR = 3.0, 0.2  # a cost that decides is so much surer, and so near [u]
CLEARER = 2.0  # a contrast's map is taken for the amplitude's if it stands out so much more
LEARNED = 65536  # samples that models are learned from, spread over the recording
LONGER = (1.0, 4.0, 16.0)  # times T, that a search is made for until its best is good
LONGEST = 2.0  # times what the rig file allows for the excitation, a run may be beyond the first T
CANDIDATES = 2  # costs that are searched for
AS_GOOD = 1.1  # raw, and a short run, are taken when the best is not better by more
RUNS = 32  # of the prediction
BLOCKS_OF_TIME = 100  # in T, of coarse surrogates at least
CLIFF = 8.0  # factor by which the amplitude changes at a cliff; less is a steep side of a valley
CLIFF_WIDTH = 0.08  # of the range, within which it does
ALL_GOOD = 2.0  # times the least amplitude: no visit of a good value is beyond
ROOM = 0.1  # of the range, that theta may go beyond the outermost good value
DOUBTED = 2.0  # standard errors, by which a value may be better than it was seen
MARGIN = 0.06  # of the range, that theta is kept away from the last good value before a cliff
BELIEVED = 10.0  # times the largest y_out of the recording


class NoOptimum(InputError):
    """There is nothing to be found; ``kind`` is monotone, flat or drowned."""

    def __init__(self, kind: str, message: str, seen: Seen) -> None:
        super().__init__(message)
        self.kind = kind
        self.seen = seen


@dataclass(frozen=True)
class Judged:
    """A cost's static maps.

    Attributes
    ----------
    cost : Cost
        The cost.
    maps : dict of float to StaticMap
        Of the logarithm of y_hp, by omega_h [rad/s]; empty where the cost cannot be made.
    tried : list of Tried
        The best constants first; empty if none were looked for.
    told : StaticMap, optional
        The amplitude's, if that does not show beyond doubt that there is an optimum.
    """

    cost: Cost
    maps: dict[float, StaticMap]
    tried: list[Tried]
    told: StaticMap | None = None

    @property
    def usable(self) -> dict[float, StaticMap]:
        """Those with an optimum inside; in doubt, those that lead to where the amplitude does."""
        told = self.told
        return {
            omega: found
            for omega, found in self.maps.items()
            if found.interior
            or (told is not None and not found.flat and abs(found.best() - told.best()) < NEAR)
        }

    @property
    def gain(self) -> float:
        """The clearest one's."""
        return max((found.gain for found in self.maps.values()), default=0.0)


class Limits(NamedTuple):
    """Limits of the controller's theta, and why each is narrower than the rig's.

    Attributes
    ----------
    low, high : float
        Least and largest theta.
    why_low, why_high : str
        In words; empty where it is the rig's.
    """

    low: float
    high: float
    why_low: str = ""
    why_high: str = ""

    @property
    def why(self) -> str:
        """Both, in words."""
        return "; ".join(why for why in (self.why_low, self.why_high) if why)


@dataclass(frozen=True)
class Seen:
    """What the recording shows.

    Attributes
    ----------
    scale, stays, amplitude, period
        Of theta; where it rested; static map of what is wanted; of the oscillation [s].
    feature : str
        In which theta shows most.
    costs : list of Judged
        Of each candidate.
    limits : Limits
        Of the controller's theta.
    doubt : str
        What is not sure about the optimum, in words; empty if it is.
    """

    scale: Scale
    stays: Stays
    amplitude: StaticMap
    period: float
    feature: str
    costs: list[Judged]
    limits: Limits
    doubt: str = ""


@dataclass(frozen=True)
class Tuning:
    """A controller for a rig.

    Attributes
    ----------
    seen : Seen
        What the recording shows.
    chosen : Judged
        The cost.
    best : Tried
        Its constants.
    task : Task
        On which they were found.
    times : Times
        How the amplitude follows theta.
    time : float
        T [s].
    y_out_max : float
        Largest y_out that is to be believed.
    prediction : Prediction
        Figures of the loop.
    runs : list of Outcome
        Runs of the prediction, from the lower and the upper end in turn.
    why : str
        Of the cost, in words.
    """

    seen: Seen
    chosen: Judged
    best: Tried
    task: Task
    times: Times
    time: float
    y_out_max: float
    prediction: Prediction
    runs: list[Outcome]
    why: str


def look(loaded: Loaded, rig: RigFile, training: BagTraining, how: Bands | None = None) -> Seen:
    """Find where theta rested, the static map of the amplitude, and that of every cost.

    Raises
    ------
    NoOptimum
        If there is none inside the range, or no cost shows it.
    ValueError
        If the recording has too few stays.
    """
    dt = rig.dt
    scale = Scale(rig.theta_min, rig.theta_max)
    sense = 1.0 if rig.objective == "minimise" else -1.0
    period = period_by_theta(loaded, scale, dt) or period_of(loaded, dt)
    if how is None:
        how = bands(loaded.x.T, window_length(period, PERIODS, dt), dt)
    stays = find_stays(loaded, scale, how, period)
    amplitude = static_map(stays, stays.amplitude, sense)
    feature = how.names(rig.names)[stays.feature]
    omega = 2.0 * math.pi / period
    judged: list[Judged] = []
    for cost in costs(loaded, training, period, LEARNED):
        maps = {}
        if cost.y_out is not None:
            for factor in HIGH:
                filtered = high_passed(cost.y_out, loaded, factor * omega, dt)
                levels = window_levels(filtered, stays)
                maps[factor * omega] = static_map(stays, levels, sense)
        judged.append(Judged(cost, maps, []))
    told = amplitude
    for one in judged:  # an interference is part of the amplitude; of a contrast it is not
        if one.cost.name.startswith("contrast") and one.cost.y_out is not None:
            own = window_levels(np.sqrt(np.nan_to_num(one.cost.y_out)), stays)
            found = static_map(stays, own, sense)
            if found.clarity > CLEARER * told.clarity:
                told = found
    limits = limits_of(amplitude, told, scale, rig)
    seen = Seen(scale, stays, amplitude, period, feature, judged, limits)
    if not told.interior and (told.flat or float(np.ptp(told.mean)) < SLIGHT):
        raise refusal(seen, rig, told)
    if not told.interior and not any(_settles(one, told) for one in judged):
        if optimum_test.best_end(sense * told.mean, told.error) is not None:
            raise refusal(seen, rig, told)
        seen = replace(seen, costs=[replace(one, told=told) for one in judged], doubt=doubt(told))
    if not any(one.usable for one in seen.costs):
        seen = replace(
            seen,
            costs=[replace(one, told=told) for one in judged],
            doubt=seen.doubt or "no cost shows the optimum of the amplitude beyond doubt",
        )
    if not any(one.usable for one in seen.costs):
        best = max(one.gain for one in seen.costs)
        raise NoOptimum(
            "drowned",
            f"the amplitude of {feature} has an optimum near {_best_theta(seen):.4g}, but no cost "
            f"shows it (gain {max(best, 0.0):.1f}): noise or interference drowns it; record with "
            "longer stays (more 'time'), or measure where the oscillation is stronger",
            seen,
        )
    return seen


def limits_of(amplitude: StaticMap, told: StaticMap, scale: Scale, rig: RigFile) -> Limits:
    """Return limits of the controller's theta: where the map is good, and some room.

    What is far from any good value was seen once and need not be seen again: a swing that is wide
    while the optimum is sought, or a loop that noise leads astray, ends at a limit where the rig
    still oscillates little. Beyond the outermost value that may be good theta has ROOM, for an
    optimum that moves.

    A cliff wants more care. A loop goes a little beyond the optimum again and again; beyond a cliff
    the cost is so large that the filters forget it only slowly, and while they do theta moves on,
    whatever it does. So there theta stays MARGIN inside the last good value.

    Parameters
    ----------
    amplitude, told : StaticMap
        Of the oscillation; what shows it most clearly, which may be the same.
    scale, rig
        Of theta, and its own limits.
    """
    found, why = [rig.theta_min, rig.theta_max], ["", ""]
    for end, side in ((0, -1), (1, 1)):
        near = beside_cliff(amplitude, side)
        if near is not None:
            found[end] = float(f"{scale.theta_at(near.u - side * MARGIN):.3g}")
            verb = "rises" if amplitude.sense > 0 else "falls"
            reason = (
                f"from {scale.theta_at(near.u):.3g} to {scale.theta_at(near.beyond):.3g} the "
                f"amplitude {verb} by a factor of {math.exp(near.height):.2g} all at once"
            )
        else:
            edge = outermost_good(told, side)
            if not 0.0 < edge + side * ROOM < 1.0:
                continue
            found[end] = float(f"{scale.theta_at(edge + side * ROOM):.3g}")
            reason = (
                f"beyond {scale.theta_at(edge):.3g} the oscillation is {GOOD:g} times the best or "
                "worse"
            )
        name = f"theta_{'max' if end else 'min'}"
        own = rig.theta_max if end else rig.theta_min
        why[end] = f"{name} {found[end]:.3g} instead of {own:g}: {reason}"
    return Limits(found[0], found[1], why[0], why[1])


class Edge(NamedTuple):
    """The last good value before a cliff, the first one beyond [u], by how much log a differs."""

    u: float
    beyond: float
    height: float


def beside_cliff(found: StaticMap, side: int) -> Edge | None:
    """Return the last good value before the cliff on a side (-1 or 1), if there is one."""
    y, u = found.sense * found.mean, found.u
    worst = [float((found.sense * own).max()) for own in found.visits]
    good = best = int(np.argmin(y))
    while 0 <= good + side < u.size and worst[good + side] - y[best] < math.log(ALL_GOOD):
        good += side
    beyond = good + side
    if not 0 <= beyond < u.size or abs(u[beyond] - u[good]) > CLIFF_WIDTH:
        return None
    height = worst[beyond] - float(y[good])
    return Edge(float(u[good]), float(u[beyond]), height) if height > math.log(CLIFF) else None


def outermost_good(found: StaticMap, side: int) -> float:
    """Return the position of the value furthest out on a side (-1 or 1) that may be good."""
    curve = found.sense * found.curve(found.mean)
    grid = np.linspace(0.0, 1.0, GRID)
    error = np.interp(grid, found.u, found.error)
    good = curve - DOUBTED * error < float(curve.min()) + math.log(GOOD)
    inside = grid[good]
    return float(inside[0] if side < 0 else inside[-1])


def doubt(found: StaticMap) -> str:
    """Return in words what a map without a clear optimum leaves open."""
    low = optimum_test.shape(found.sense * found.mean, found.error).rising
    span, error = float(np.ptp(found.mean)), float(np.median(found.error))
    return (
        f"the amplitude changes by {100 * math.expm1(span):.2g} %, but whether it gets worse again "
        f"towards theta_{'min' if low else 'max'} is not sure (errors of {100 * error:.2g} %): if "
        "not, theta will stay near that limit"
    )


def _settles(judged: Judged, amplitude: StaticMap) -> bool:
    """Return whether a cost shows beyond doubt the optimum that the amplitude only suggests."""
    return any(
        found.gain > DECIDES * SURE and abs(found.best() - amplitude.best()) < NEAR
        for found in judged.maps.values()
    )


def _best_theta(seen: Seen) -> float:
    return seen.scale.theta_at(seen.amplitude.best())


def refusal(seen: Seen, rig: RigFile, found: StaticMap) -> NoOptimum:
    """Return why a map has no optimum inside, and what to record next."""
    span, error = float(np.ptp(found.mean)), float(np.median(found.error))
    if found.flat or span < SLIGHT:
        return NoOptimum(
            "flat",
            f"over theta's range the amplitude of {seen.feature} differs by "
            f"{100 * math.expm1(span):.2g} %, with errors of {100 * error:.2g} %, and shows no "
            "optimum: see with koop check whether theta reaches the rig and what hides "
            "the oscillation, then record wider limits or longer stays (more 'time')",
            seen,
        )
    end = int(np.argmin(found.sense * found.mean))
    name, value = ("theta_min", rig.theta_min) if end == 0 else ("theta_max", rig.theta_max)
    return NoOptimum(
        "monotone",
        f"the amplitude of {seen.feature} is best at {name} = {value:g}, the limit: there is "
        f"nothing to seek; leave theta there, or record with a {name} beyond it",
        seen,
    )


def task_of(
    loaded: Loaded, seen: Seen, judged: Judged, times: Times, time: float, rig: RigFile, seed: int
) -> Task:
    """Return the rigs that the recording may be of, for one cost and each corner frequency."""
    y_out = judged.cost.y_out
    assert y_out is not None
    every = max(1, int(time / (BLOCKS_OF_TIME * rig.dt)))
    parts, first = pieces_of(y_out, seen.stays)
    sizes = [part.size for part in parts]
    y, begins = np.concatenate(parts), np.cumsum([0, *sizes])
    fine: dict[float, list[Surrogate]] = {}
    coarse: dict[float, list[Surrogate]] = {}
    for omega_h, found in judged.usable.items():
        drawn = surrogates(seen, found, Recorded(y, begins, first, rig.dt), times, seed)
        filtered, _ = pieces_of(high_passed(y_out, loaded, omega_h, rig.dt), seen.stays)
        blocks = [rms(part, every) for part in filtered]
        ends = np.cumsum([0, *(block.size for block in blocks)])
        fine[omega_h] = drawn
        coarse[omega_h] = [
            s._replace(y=np.concatenate(blocks), begins=ends, dt=every * rig.dt, coarse=True)
            for s in drawn
        ]
    low, high = seen.limits[:2]
    return Task(fine, coarse, seen.amplitude.sense, time, rig.dt, rig.theta_rate, low, high)


class Recorded(NamedTuple):
    """Pieces of a signal in a row: see :class:`koop_tune.rig_model.surrogate.Surrogate`."""

    y: NDArray[np.float64]
    begins: NDArray[np.int64]
    first: NDArray[np.int64]
    dt: float


def pieces_of(
    values: NDArray[np.float64], stays: Stays
) -> tuple[list[NDArray[np.float64]], NDArray[np.int64]]:
    """Return a signal of each stay once the rig had settled, without its mean, by theta."""
    by_level = sorted(stays.stays, key=lambda s: s.level)
    parts = []
    for stay in by_level:
        part = values[stay.begin + stay.skip * stays.how.length : stay.end]
        part = part[np.isfinite(part)]
        parts.append(part - part.mean() if part.size else np.zeros(2))
    return parts, np.searchsorted([s.level for s in by_level], np.arange(stays.u.size + 1))


def rms(values: NDArray[np.float64], every: int) -> NDArray[np.float64]:
    """Return the root mean square of blocks."""
    every = min(every, values.size)
    whole = values[: values.size // every * every].reshape(-1, every)
    return np.asarray(np.sqrt((whole**2).mean(axis=1)))


def surrogates(
    seen: Seen, found: StaticMap, recorded: Recorded, times: Times, seed: int
) -> list[Surrogate]:
    """Return rigs that the recording may be of."""
    stays, rng = seen.stays, np.random.default_rng(seed)
    made = []
    for i in range(SURROGATES):
        weights = weights_of(found, rng)
        shift = float(rng.normal(0.0, UNSURE))
        if i == 0:  # as it was seen
            weights, shift = [np.full(v.size, 1.0 / v.size) for v in found.visits], 0.0
        made.append(
            Surrogate(
                found.curve(found.drawn(weights)),
                seen.amplitude.curve(seen.amplitude.drawn(weights)),
                stays.u, found.mean, recorded.y, recorded.begins, recorded.first,
                times._replace(usual=times.usual + shift), recorded.dt, seen.scale.low,
                seen.scale.high, seen.scale.logarithmic, False,
            )
        )  # fmt: skip
    return made


def tune(
    loaded: Loaded,
    rig: RigFile,
    training: BagTraining,
    how: Bands | None = None,
    seed: int = 0,
    effort: float = 1.0,
    said: Callable[[str, float], None] = lambda what, share: None,
    slower: float = 1.0,
    workers: int = 2,
) -> Tuning:
    """Choose the cost and all constants of a controller.

    Parameters
    ----------
    loaded : Loaded
        The excitation, theta included.
    rig : RigFile
        Limits, rate, objective, dt.
    training : BagTraining
        With which models are learned.
    how : Bands, optional
        How the excitation looked at its windows.
    seed : int
        Of every draw.
    effort : float
        Of the search, in units of the usual one.
    said : callable
        Told what is done, and of each step its share of all.
    slower : float
        By how much the rig follows theta more slowly than its stays say, as a loop has shown.
    workers : int
        Threads of the search.

    Raises
    ------
    NoOptimum
        If there is nothing to be found.
    ValueError
        If the recording cannot be used.
    """
    said("costs", 0.0)
    seen = look(loaded, rig, training, how)
    times = fit_times(loaded, seen.stays, seen.amplitude, seen.scale, rig.dt)
    middle = [times.tau(float(a), up) for a in seen.amplitude.mean for up in (False, True)]
    slower = believed(slower, max(middle), rig.time)
    times = times._replace(usual=times.usual + math.log(slower))
    time = slower * float(max(middle)) + 2.0 * seen.period
    wanted = sorted((j for j in seen.costs if j.usable), key=lambda j: -j.gain)
    chosen = wanted[:CANDIDATES]
    chosen += [j for j in wanted[CANDIDATES:] if j.cost.name == "raw"]
    searched = []
    tasks = {}
    for judged in chosen:
        name, share = judged.cost.name, 1.0 / (len(chosen) * len(LONGER))

        def told(part: float, name: str = name, share: float = share) -> None:
            said(name, part * share)

        tried: list[Tried] = []
        for longer in LONGER:  # as short as it can be, as long as it must
            task = task_of(loaded, seen, judged, times, longer * time, rig, seed)
            if tried and task.steps * rig.dt > LONGEST * rig.time:
                break  # nobody waits for it, and no rig stays as it was for so long
            again = search(task, effort, seed, told, workers)
            if not tried or again[0].rank < tried[0].rank - math.log(AS_GOOD):
                tried, tasks[name] = again, task
            if tried[0].score < math.log(GOOD):
                break
        searched.append(replace(judged, tried=tried))
    searched.sort(key=lambda j: j.tried[0].score)
    best, why = choose(searched)
    left = [j for j in seen.costs if j.cost.name not in tasks]
    seen = replace(seen, costs=[*searched, *left])
    task = tasks[best.cost.name]
    top = confirm(task, best.tried, seed)[0]
    assert best.cost.y_out is not None
    largest = float(np.nanmax(best.cost.y_out))
    return Tuning(
        seen,
        best,
        top,
        task,
        times,
        task.time,
        BELIEVED * largest,
        *predict(task, top, seen, seed + 1),
        why,
    )


def believed(slower: float, tau: float, time: float) -> float:
    """Return by how much a rig may count as slower than its stays say.

    What its loops say has a limit: a run of the loop must not take longer than LONGEST times what
    the rig file allows for the excitation.

    Parameters
    ----------
    slower : float
        As its loops say.
    tau : float
        Its slowest time, as its stays say [s].
    time : float
        Of the rig file [s].

    Examples
    --------
    >>> believed(16.0, 10.0, 2000.0)  # the run is one of 80 * 10 s then
    5.0
    >>> believed(4.0, 10.0, 2000.0), believed(4.0, 100.0, 2000.0)
    (4.0, 1.0)
    """
    return min(slower, max(LONGEST * time / (LENGTH * tau), 1.0))


def choose(searched: list[Judged]) -> tuple[Judged, str]:
    """Return the cost, and why; the best is first in the list."""
    best = searched[0]
    raw = next((j for j in searched if j.cost.name == "raw"), None)
    told = ", ".join(f"{j.cost.name} {math.exp(j.tried[0].score):.3g}" for j in searched)
    if raw is not None:
        worse = math.exp(raw.tried[0].score - best.tried[0].score)
        if worse <= AS_GOOD:
            return raw, f"raw is as good as any (score, 1 is perfect: {told}) and needs no model"
        return best, f"raw is worse by {100 * (worse - 1):.0f} % (score, 1 is perfect: {told})"
    return best, f"raw does not show the optimum (score, 1 is perfect: {told})"


def wander(stays: Stays, samples: float) -> float:
    """Return by how much the logarithm of an amplitude over so many samples differs by itself."""
    found = []
    for values in stays.settled(stays.amplitude):
        error = float(level(values[:, None])[1][0])
        if math.isfinite(error):
            found.append(error * math.sqrt(values.size * stays.how.length / samples))
    return float(np.median(found)) if found else 0.0


def predict(task: Task, tried: Tried, seen: Seen, seed: int) -> tuple[Prediction, list[Outcome]]:
    """Run what was chosen with fresh random numbers.

    What the amplitude of a time as long as half a run differs by itself, and the error of the best
    one, widen the bands.
    """
    runs = [try_out(task, tried.constants, n, seed) for n in range(RUNS)]
    own = wander(seen.stays, 0.5 * task.steps)
    known = float(seen.amplitude.error[int(np.argmin(task.sense * seen.amplitude.mean))])
    rng = np.random.default_rng(seed)
    noise = np.exp(math.hypot(own, known) * rng.standard_normal(RUNS)).tolist()
    prediction = Prediction(
        Band.of([o.converged for o in runs]),
        Band.of([o.distance for o in runs]),
        Band.of([o.excess * e for o, e in zip(runs, noise, strict=True)]),
        Band.of([o.reduction / e for o, e in zip(runs, noise, strict=True)]),
        task.steps * task.dt,
        len(runs),
    )
    return prediction, runs
