"""From an excitation to a cost with all its constants, or why there are none. Pure: no ROS."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from koop_lab.commission.features import Bands, bands, window_length
from koop_lab.commission.rig_file import RigFile
from koop_lab.commission.staircase import standard_error
from koop_lab.identify.compare import BAND_LIMITED, Cost, costs
from koop_lab.identify.from_bags import BagTraining
from koop_lab.identify.loaded import Loaded
from koop_lab.identify.windows import period_of
from koop_lab.tune.search import HIGH, Outcome, Task, Tried, search, try_out
from koop_lab.tune.static_map import SURE, StaticMap, static_map, weights_of
from koop_lab.tune.stays import Scale, Stays, find_stays, period_by_theta, window_levels
from koop_lab.tune.surrogate import Surrogate, Times, fit_times, high_passed

PERIODS = 4.0  # of the oscillation, in a window
SURROGATES = 6
UNSURE = 0.2  # standard deviation of the logarithm of tau
DECIDES, NEAR = 3.0, 0.2  # a cost that decides is so much surer, and so near [u]
CANDIDATES = 3  # costs that are searched for
AS_GOOD = 1.05  # raw is taken when the best is not better by more
RUNS = 64  # of the prediction
BAND = (5.0, 50.0, 95.0)  # percentiles that are told
STEPS = 1.0e9  # of all runs: most of the time that it takes
BELIEVED = 10.0  # times the largest y_out of the recording


class NoOptimum(ValueError):
    """There is nothing to be found; ``kind`` is monotone, flat, unsure or drowned."""

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
    """

    cost: Cost
    maps: dict[float, StaticMap]
    tried: list[Tried]

    @property
    def usable(self) -> dict[float, StaticMap]:
        """Those with an optimum inside."""
        return {omega: found for omega, found in self.maps.items() if found.interior}

    @property
    def gain(self) -> float:
        """The clearest one's."""
        return max((found.gain for found in self.maps.values()), default=0.0)


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
    """

    scale: Scale
    stays: Stays
    amplitude: StaticMap
    period: float
    feature: str
    costs: list[Judged]


@dataclass(frozen=True)
class Band:
    """A figure with its band: 5 %, median, 95 % of the runs."""

    low: float
    middle: float
    high: float

    @classmethod
    def of(cls, values: list[float]) -> Band:
        """Return the band of values."""
        low, middle, high = np.percentile(values, BAND, method="nearest")
        return cls(float(low), float(middle), float(high))


@dataclass(frozen=True)
class Prediction:
    """What the loop will do.

    Attributes
    ----------
    converges : Band
        Time until the amplitude is near its best [s].
    distance : Band
        Mean distance of theta from the best [u] once it has.
    excess : Band
        Amplitude then over the best one (its inverse where it is to be large).
    reduction : Band
        Amplitude at the start over that (its inverse), from the worse end of the range.
    duration : float
        Of a run [s]; the second half counts as converged.
    runs : list of Outcome
        All of them.
    """

    converges: Band
    distance: Band
    excess: Band
    reduction: Band
    duration: float
    runs: list[Outcome]


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
        What will be.
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
    seen = Seen(scale, stays, amplitude, period, feature, [])
    inside = 0 < int(np.argmin(sense * amplitude.mean)) < stays.u.size - 1
    if not amplitude.interior and (amplitude.flat or not inside):
        raise refusal(seen, rig)
    omega = 2.0 * math.pi / period
    for cost in costs(loaded, training, period):
        if cost.name == BAND_LIMITED:
            continue
        maps = {}
        if cost.y_out is not None:
            for factor in HIGH:
                filtered = high_passed(cost.y_out, loaded, factor * omega, dt)
                levels = window_levels(filtered, stays)
                maps[factor * omega] = static_map(stays, levels, sense)
        seen.costs.append(Judged(cost, maps, []))
    if not amplitude.interior and not any(_settles(judged, amplitude) for judged in seen.costs):
        raise refusal(seen, rig)
    if not any(judged.usable for judged in seen.costs):
        best = max(judged.gain for judged in seen.costs)
        raise NoOptimum(
            "drowned",
            f"the amplitude of {feature} has an optimum near {_best_theta(seen):.4g}, but no cost "
            f"shows it (gain {max(best, 0.0):.1f}): noise or interference drowns it; record with "
            "longer stays (more 'time'), or measure where the oscillation is stronger",
            seen,
        )
    return seen


def _settles(judged: Judged, amplitude: StaticMap) -> bool:
    """Return whether a cost shows beyond doubt the optimum that the amplitude only suggests."""
    return any(
        found.gain > DECIDES * SURE and abs(found.best() - amplitude.best()) < NEAR
        for found in judged.maps.values()
    )


def _best_theta(seen: Seen) -> float:
    return seen.scale.theta_at(seen.amplitude.best())


def refusal(seen: Seen, rig: RigFile) -> NoOptimum:
    """Return why there is no optimum inside, and what to record next."""
    found = seen.amplitude
    span = float(np.ptp(found.mean))
    error = float(np.median(found.error))
    if found.flat:
        return NoOptimum(
            "flat",
            f"theta does nothing to the amplitude of {seen.feature} that {100 * error:.2g} % of "
            "error would show: see with koop check whether theta reaches the rig and what hides "
            "the oscillation, then record wider limits or longer stays (more 'time')",
            seen,
        )
    end = int(np.argmin(found.sense * found.mean))
    low = 2 * end < found.u.size
    name, value = ("theta_min", rig.theta_min) if low else ("theta_max", rig.theta_max)
    if end in (0, found.u.size - 1):
        return NoOptimum(
            "monotone",
            f"the amplitude of {seen.feature} is best at {name} = {value:g}, the limit: there is "
            f"nothing to seek; leave theta there, or record with a {name} beyond it",
            seen,
        )
    return NoOptimum(
        "unsure",
        f"the amplitude of {seen.feature} changes by {100 * math.expm1(span):.2g} %, but whether "
        f"it gets worse again towards {name} is not sure (errors of {100 * error:.2g} %): record "
        "longer stays (more 'time') or a wider range",
        seen,
    )


def surrogates(
    loaded: Loaded, seen: Seen, judged: Judged, omega_h: float, times: Times, dt: float, seed: int
) -> list[Surrogate]:
    """Return rigs that the recording may be of, for one cost and corner frequency."""
    y_out = judged.cost.y_out
    assert y_out is not None
    stays, found = seen.stays, judged.maps[omega_h]
    length = stays.how.length
    by_level = sorted(stays.stays, key=lambda s: s.level)
    parts = []
    for stay in by_level:
        part = y_out[stay.begin + stay.skip * length : stay.end]
        part = part[np.isfinite(part)]
        parts.append(part - part.mean() if part.size else np.zeros(2))
    begins = np.cumsum([0, *(part.size for part in parts)])
    first = np.searchsorted([s.level for s in by_level], np.arange(stays.u.size + 1))
    rng = np.random.default_rng(seed)
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
                stays.u, found.mean, np.concatenate(parts), begins, first,
                times._replace(usual=times.usual + shift), dt, seen.scale.low, seen.scale.high,
                seen.scale.logarithmic,
            )
        )  # fmt: skip
    return made


def tune(
    loaded: Loaded,
    rig: RigFile,
    training: BagTraining,
    how: Bands | None = None,
    seed: int = 0,
    steps: float = STEPS,
    said: Callable[[str, float], None] = lambda what, share: None,
    slower: float = 1.0,
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
    steps : float
        Steps of the closed loop that may be simulated.
    said : callable
        Told what is done, and of each step its share of all.
    slower : float
        By how much the rig follows theta more slowly than its stays say, as a loop has shown.

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
    times = times._replace(usual=times.usual + math.log(slower))
    middle = [times.tau(float(a), up) for a in seen.amplitude.mean for up in (False, True)]
    time = float(max(middle)) + 2.0 * seen.period
    wanted = sorted((j for j in seen.costs if j.usable), key=lambda j: -j.gain)
    chosen = wanted[:CANDIDATES]
    chosen += [j for j in wanted[CANDIDATES:] if j.cost.name == "raw"]
    searched = []
    tasks = {}
    for judged in chosen:
        task = Task(
            {w: surrogates(loaded, seen, judged, w, times, rig.dt, seed) for w in judged.usable},
            seen.amplitude.sense, time, rig.dt, rig.theta_rate,
        )  # fmt: skip
        name, share = judged.cost.name, 1.0 / len(chosen)

        def told(part: float, name: str = name, share: float = share) -> None:
            said(name, part * share)

        tried = search(task, steps / len(chosen), seed, told)
        tasks[name] = task
        searched.append(replace(judged, tried=tried))
    searched.sort(key=lambda j: j.tried[0].score)
    best, why = choose(searched)
    left = [j for j in seen.costs if j.cost.name not in tasks]
    seen = replace(seen, costs=[*searched, *left])
    task, top = tasks[best.cost.name], best.tried[0]
    assert best.cost.y_out is not None
    largest = float(np.nanmax(best.cost.y_out))
    return Tuning(
        seen,
        best,
        top,
        task,
        times,
        time,
        BELIEVED * largest,
        predict(task, top, seen, seed + 1),
        why,
    )


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
        error = float(standard_error(values[:, None])[0])
        if math.isfinite(error):
            found.append(error * math.sqrt(values.size * stays.how.length / samples))
    return float(np.median(found)) if found else 0.0


def predict(task: Task, tried: Tried, seen: Seen, seed: int) -> Prediction:
    """Run what was chosen with fresh random numbers.

    What the amplitude of a time as long as half a run differs by itself, and the error of the best
    one, widen the bands.
    """
    runs = [try_out(task, tried.constants, n, seed) for n in range(RUNS)]
    own = wander(seen.stays, 0.5 * task.steps)
    known = float(seen.amplitude.error[int(np.argmin(task.sense * seen.amplitude.mean))])
    rng = np.random.default_rng(seed)
    noise = np.exp(math.hypot(own, known) * rng.standard_normal(RUNS)).tolist()
    return Prediction(
        Band.of([o.converged for o in runs]),
        Band.of([o.distance for o in runs]),
        Band.of([o.excess * e for o, e in zip(runs, noise, strict=True)]),
        Band.of([o.reduction / e for o, e in zip(runs, noise, strict=True)]),
        task.steps * task.dt,
        runs,
    )
