"""From an excitation to a cost with all its constants, or why there are none."""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from koop_identify.model.from_bags import BagTraining
from koop_identify.recording.loaded import Loaded
from koop_tune.excitation.amplitude import Amplitude
from koop_tune.excitation.safe_range import SafeRange
from koop_tune.rig.rig_file import RigFile
from koop_tune.rig_model.surrogate import fit_times
from koop_tune.search.findings import CostMaps, Findings, NoOptimum, analyse
from koop_tune.search.limits import limit_theta
from koop_tune.search.prediction import Prediction, predict
from koop_tune.search.run import Outcome, Task
from koop_tune.search.search import Trial, confirm, search
from koop_tune.search.settings import CONVERGENCE, TUNING, TuningSettings
from koop_tune.search.task import make_task

Report = Callable[[str], object]


@dataclass(frozen=True)
class SearchedCost:
    """A cost with its constants, the best first, and the rigs on which they were found."""

    maps: CostMaps
    trials: list[Trial]
    task: Task

    @property
    def name(self) -> str:
        """The cost's name."""
        return self.maps.cost.name

    @property
    def score(self) -> float:
        """Logarithm of the score of the best constants."""
        return self.trials[0].score


@dataclass(frozen=True)
class Tuning:
    """A controller for a rig.

    Attributes
    ----------
    findings : Findings
        What the recording shows.
    searched : list of SearchedCost
        Costs for which constants were searched, the best first.
    chosen : SearchedCost
        The one that was chosen.
    best : Trial
        Its constants.
    y_out_max : float
        Largest y_out that is to be believed.
    prediction : Prediction
        Figures of the loop.
    runs : list of Outcome
        Runs of the prediction, from the lower and the upper end in turn.
    why : str
        Why this cost, in words.
    """

    findings: Findings
    searched: list[SearchedCost]
    chosen: SearchedCost
    best: Trial
    y_out_max: float
    prediction: Prediction
    runs: list[Outcome]
    why: str

    @property
    def task(self) -> Task:
        """Rigs on which the constants were found."""
        return self.chosen.task

    @property
    def time(self) -> float:
        """T [s]."""
        return self.task.time


def tune(
    loaded: Loaded,
    rig: RigFile,
    training: BagTraining,
    amplitude: Amplitude | None = None,
    settings: TuningSettings = TUNING,
    report: Report = lambda step: None,
    safe: SafeRange | None = None,
) -> Tuning:
    """Choose the cost and all constants of a controller.

    Parameters
    ----------
    loaded : Loaded
        The excitation, theta included.
    rig : RigFile
        Limits, rate, objective, dt.
    training : BagTraining
        How models are learned.
    amplitude : Amplitude, optional
        The one of the excitation; chosen from the recording without.
    settings : TuningSettings
        Budget and thresholds.
    report : callable
        Is told each step, in words.
    safe : SafeRange, optional
        Thetas that keep the constraint; the rig's limits are within them.

    Raises
    ------
    NoOptimum
        If there is no optimum to seek.
    koop_core.errors.InputError
        If the recording cannot be used.
    """
    report("the static maps of amplitude and costs")
    findings = analyse(loaded, rig, training, amplitude, settings, safe)
    times = fit_times(loaded, findings.dwells, findings.static_map, findings.scale, rig.dt)
    slowest = max(times.tau(float(a), up) for a in findings.static_map.mean for up in (False, True))
    slowdown = limit_slowdown(slowest, rig.time, settings)
    times = times._replace(usual=times.usual + math.log(slowdown))
    time = slowdown * slowest + 2.0 * findings.period
    motion = findings.speed * settings.ahead * settings.search.length * time
    limits = limit_theta(findings.static_map, rig, settings, safe, motion)
    findings = replace(findings, limits=limits)
    usable = sorted((j for j in findings.costs if j.usable), key=lambda j: -j.evidence)
    candidates = usable[: settings.candidates]
    candidates += [j for j in usable[settings.candidates :] if j.cost.name == "raw"]
    searched = []
    for maps in candidates:
        report(f"constants for the cost {maps.cost.name}")
        make = functools.partial(
            make_task, loaded, findings, maps, times, rig=rig, settings=settings
        )
        searched.append(search_cost(make, time, maps, rig, settings))
    searched.sort(key=lambda s: s.score)
    chosen, why = choose(searched, settings.as_good)
    best = confirm(chosen.task, chosen.trials, settings.seed)[0]
    assert chosen.maps.cost.y_out is not None
    largest = float(np.nanmax(chosen.maps.cost.y_out))
    prediction = predict(chosen.task, best, findings, settings.seed + 1, settings.runs)
    refuse_undamped(prediction[0], findings)
    return Tuning(findings, searched, chosen, best, settings.y_out_max * largest, *prediction, why)


def refuse_undamped(prediction: Prediction, findings: Findings) -> None:
    """Refuse a controller whose prediction is not a damped rig.

    Raises
    ------
    NoOptimum
        If it is not.
    """
    excess, late = prediction.excess, prediction.converges
    if excess.middle <= CONVERGENCE.good and math.isfinite(late.middle):
        return
    ends = f"{excess.as_text()} times the best amplitude"
    if findings.static_map.sense < 0.0:
        ends = f"the best amplitude over {excess.as_text()}"
    low, high = findings.scale.theta(np.array(findings.static_map.valley()))
    best = f"{findings.scale.theta_at(findings.static_map.best()):.4g}"
    if findings.static_map.motion:  # or a hysteresis that looks like one
        best = f"theta_safe (best was {best}, which seems to move)"
    raise NoOptimum(
        "undamped",
        f"with the best constants of the search the loop is predicted to end at {ends} and to "
        f"converge in {late.as_text()} s, on the rig that the "
        f"recording shows; the valley reaches from {low:.4g} to {high:.4g}: leave theta at "
        f"{best}, or set theta_min and theta_max closer around the valley and record again",
        findings,
    )


def search_cost(
    make: Callable[[float], Task], time: float, maps: CostMaps, rig: RigFile,
    settings: TuningSettings,
) -> SearchedCost:  # fmt: skip
    """Search constants for a cost with runs as short as they can be, as long as they must.

    ``make`` returns the task for a rig's own time [s]; it is ``time`` or a multiple.
    """
    workers = settings.workers or len(os.sched_getaffinity(0))
    best: SearchedCost | None = None
    for longer in settings.longer:
        task = make(longer * time)
        if best is not None and task.steps * rig.dt > settings.longest * rig.time:
            break  # nobody waits for it, and no rig stays as it was for so long
        trials = search(task, settings.effort, settings.seed, workers)
        if best is None or trials[0].rank < best.trials[0].rank - math.log(settings.as_good):
            best = SearchedCost(maps, trials, task)
        if best.score < math.log(CONVERGENCE.good):
            break
    assert best is not None
    return best


def limit_slowdown(tau: float, time: float, settings: TuningSettings) -> float:
    """Return the factor by which a rig may count as slower than its rests show.

    What its loops show has a limit: a run of the loop must not take longer than the rig file allows
    for the excitation, times ``settings.longest``.

    Parameters
    ----------
    tau : float
        Its slowest time, as its rests show [s].
    time : float
        The rig file's [s].
    settings : TuningSettings
        The slowdown that its loops show, and the length of a run.
    """
    longest = settings.longest * time / (settings.search.length * tau)
    return min(settings.slowdown, max(longest, 1.0))


def choose(searched: list[SearchedCost], as_good: float) -> tuple[SearchedCost, str]:
    """Return the cost, and why; the best is first in the list."""
    best = searched[0]
    raw = next((s for s in searched if s.name == "raw"), None)
    scores = ", ".join(f"{s.name} {math.exp(s.score):.3g}" for s in searched)
    if raw is None:
        return best, f"raw does not show the optimum (score, 1 is perfect: {scores})"
    worse = math.exp(raw.score - best.score)
    if worse <= as_good:
        how = "is the best" if raw is best else f"is worse by {100 * (worse - 1):.0f} % only"
        return raw, f"raw {how} (score, 1 is perfect: {scores}) and needs no model"
    return best, f"raw is worse by {100 * (worse - 1):.0f} % (score, 1 is perfect: {scores})"
