"""The headline runs again, by the real nodes over DDS in lockstep: they must be the same runs."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path

from tqdm import tqdm

from koop_bringup.live.loop import LiveLoop
from koop_bringup.live.monitor import Progress
from koop_core.errors import InputError
from koop_identify.recording.loop import LoopRecord, read_run
from koop_loop.parameters import LoopParameters
from koop_study.experiments.kinds import Experiment
from koop_study.over_dds.headline import Headline, compare, headlines
from koopman_lifter.config import ModelConfig
from vdp_plant.config import PaceConfig

HEADER = ("run", "steps", "differing_columns", "first_difference", "largest_difference", "lost")


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
    runs = [
        run
        for experiment in experiments
        if experiment.kind == "closed_loop"
        for run in headlines(experiment.config)
    ]
    rows = []
    for run in runs:
        recorded = _run(run, out / "over_dds" / re.sub(r"[^a-z]+", "_", run.name))
        found = compare(
            run.offline(),
            {
                "step": recorded.step,
                "measured": recorded.measured,
                "r": recorded.r,
                "theta": recorded.theta,
            },
        )
        first = min(found, key=lambda difference: difference.first_step) if found else None
        print(
            f"{run.name}: {run.steps} steps over DDS, "
            + (f"differ from step {first.first_step} on" if first else "identical to the last bit")
        )
        rows.append(
            (
                run.name,
                run.steps,
                " ".join(difference.column for difference in found),
                first.first_step if first else "",
                max((difference.largest for difference in found), default=0.0),
                sum(recorded.lost.values()),
            )
        )
    (out / "tables").mkdir(parents=True, exist_ok=True)
    with (out / "tables" / "over_dds.csv").open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([HEADER, *rows])
    return all(not row[2] for row in rows)


def _run(run: Headline, folder: Path) -> LoopRecord:
    """Run a headline with the nodes; a recording that is there already is not made again.

    Raises
    ------
    ValueError
        If it was broken off.
    """
    made = not (folder / "bag").exists()
    if made:
        folder.mkdir(parents=True, exist_ok=True)
        model = ModelConfig()
        if run.model is not None:
            path = folder / "headline_model.npz"
            run.model.save(path)
            model = replace(model, model=str(path.resolve()))
        duration = run.steps * run.plant.dt
        pace = PaceConfig(pace="lockstep", duration=duration)
        parameters = LoopParameters(run.plant, pace, run.lifter, model, run.esc)
        with (
            tqdm(total=round(duration), unit="s", desc=run.name, disable=None) as bar,
            LiveLoop(folder, parameters) as loop,
        ):

            def show(progress: Progress) -> None:
                bar.update(round(progress.step * run.plant.dt) - bar.n)

            loop.run(show)
    recorded = read_run(folder / "bag")
    if not made and recorded.step.size < run.steps:
        raise InputError(
            f"{folder} holds the first {recorded.step.size} of {run.steps} steps of a run that was "
            "broken off: remove it to run it again"
        )
    return recorded
