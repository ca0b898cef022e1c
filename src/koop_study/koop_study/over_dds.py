"""The headline runs again, by the real nodes over DDS in lockstep: they must be the same runs.

A headline run is a row of the report's closed-loop table: a case that the nodes can run as it is.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from koop_bag.bag.column_diff import ColumnDiff, column_diff
from koop_bringup.live.loop import LiveLoop
from koop_bringup.live.monitor import Progress
from koop_core.errors import InputError
from koop_identify.recording.loop import LoopRecord, read_run
from koop_loop.loop import LoopResult, simulate
from koop_loop.parameters import LoopParameters
from koop_study.experiments.closed_loop import ClosedLoopConfig
from koop_study.experiments.kinds import Experiment
from koop_study.simulation.case import Case, model_of
from koop_study.simulation.work import case_of
from koopman_lifter.config import ModelConfig
from koopman_lifter.model import KoopmanModel
from vdp_plant.config import PaceConfig

HEADER = ("run", "steps", "differing_columns", "first_difference", "largest_difference", "lost")
COLUMNS = ("measured", "r", "theta")


@dataclass(frozen=True)
class Headline:
    """A run for the three nodes.

    Attributes
    ----------
    name : str
        Row of the report's closed-loop table.
    parameters : LoopParameters
        Of the nodes.
    model : KoopmanModel or None
        For the lifter's model file; None for the raw cost.
    steps : int
        Length of the run.
    """

    name: str
    parameters: LoopParameters
    model: KoopmanModel | None
    steps: int

    def offline(self) -> LoopResult:
        """Return the run of the offline loop."""
        given = self.parameters
        return simulate(given.plant, given.lifter, given.esc, self.model, self.steps)


def headlines(config: ClosedLoopConfig) -> list[Headline]:
    """Return the runs of the report's closed-loop table, in its order."""
    return [
        headline(name, case_of({**config.settings, **settings}, None))
        for name, settings in config.costs.items()
    ]


def headline(name: str, case: Case) -> Headline:
    """Return a case as a run for the nodes.

    Raises
    ------
    koop_core.errors.InputError
        If the case has a disturbance that the nodes do not have.
    """
    if case.scenario != Case().scenario:
        raise InputError(
            f"the nodes cannot run '{name}': it needs more than plant, lifter and relay"
        )
    model = model_of(case)
    lifter = replace(case.lifter, cost="raw" if model is None else "lifted")
    pace = PaceConfig(pace="lockstep", duration=case.steps * case.plant.dt)
    parameters = LoopParameters(case.plant, pace, lifter, ModelConfig(), case.esc)
    return Headline(name, parameters, model, case.steps)


def compare(offline: LoopResult, recorded: Mapping[str, NDArray[Any]]) -> dict[str, ColumnDiff]:
    """Compare a recorded run with the offline loop.

    Parameters
    ----------
    offline : LoopResult
        The run it should be.
    recorded : mapping
        Columns of the bag by name: ``step``, shape (M,); ``measured``, shape (M, 2); ``r`` and
        ``theta``, shape (M,). Row i belongs to step ``step[i]``.

    Returns
    -------
    dict of str to ColumnDiff
        Where the columns differ, or only ``step`` if steps are missing or out of order. Empty if
        every step is there and every value equals the offline one to the last bit.
    """
    step, expected = np.asarray(recorded["step"]), offline.step
    if not np.array_equal(step, expected):
        shared = min(step.size, expected.size)
        wrong = np.flatnonzero(step[:shared] != expected[:shared])
        first = int(wrong[0]) if wrong.size else shared
        missing = int(np.setdiff1d(expected, step).size)
        return {"step": ColumnDiff(max(missing, wrong.size), first, float("nan"), first)}
    found = {}
    for name in COLUMNS:
        ours, theirs = np.asarray(getattr(offline, name)), np.asarray(recorded[name], np.float64)
        difference = column_diff(ours, theirs.reshape(ours.shape), bitwise=True)
        if difference is not None:
            found[name] = difference
    return found


def repeat(experiments: list[Experiment], out: Path) -> bool:
    """Run every headline over DDS and compare it with the offline loop, bit for bit.

    Parameters
    ----------
    experiments : list of Experiment
        Those of the kind ``closed_loop`` hold the headline runs.
    out : Path
        Folder of the study; receives ``over_dds/RUN/`` and ``tables/over_dds.csv``.

    Returns
    -------
    bool
        True if all runs are identical.

    Raises
    ------
    koop_core.errors.LiveError
        If a node fails.
    """
    configs = [item.config for item in experiments if item.kind == "closed_loop"]
    rows = []
    for run in (run for config in configs for run in headlines(config)):
        recorded = record(run, out / "over_dds" / re.sub(r"[^a-z]+", "_", run.name))
        found = compare(
            run.offline(), {name: getattr(recorded, name) for name in ("step", *COLUMNS)}
        )
        first = min((difference.first for difference in found.values()), default=None)
        same = "identical to the last bit" if first is None else f"differ from step {first} on"
        print(f"{run.name}: {run.steps} steps over DDS, {same}")
        largest = max((difference.largest for difference in found.values()), default=0.0)
        lost = sum(recorded.lost.values())
        rows.append((run.name, run.steps, " ".join(found), first, largest, lost))
    (out / "tables").mkdir(parents=True, exist_ok=True)
    with (out / "tables" / "over_dds.csv").open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([HEADER, *rows])
    return not any(row[2] for row in rows)


def record(run: Headline, folder: Path) -> LoopRecord:
    """Run a headline with the nodes; a recording that is there already is not made again.

    Raises
    ------
    koop_core.errors.InputError
        If the recording that is there was broken off.
    """
    made = not (folder / "bag").exists()
    if made:
        folder.mkdir(parents=True, exist_ok=True)
        parameters = run.parameters
        if run.model is not None:
            path = (folder / "headline_model.npz").resolve()
            run.model.save(path)
            parameters = replace(parameters, model=ModelConfig(model=str(path)))
        dt = parameters.plant.dt
        with (
            tqdm(total=round(run.steps * dt), unit="s", desc=run.name, disable=None) as bar,
            LiveLoop(folder, parameters) as loop,
        ):

            def show(progress: Progress) -> None:
                bar.update(round(progress.step * dt) - bar.n)

            loop.run(show)
    recorded = read_run(folder / "bag")
    if not made and recorded.step.size < run.steps:
        raise InputError(
            f"{folder} holds the first {recorded.step.size} of {run.steps} steps of a run that was "
            "broken off: remove it to run it again"
        )
    return recorded
