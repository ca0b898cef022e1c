"""How a model does on a recording: as a forecast, and as the cost that is to steer a rig."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_identify.model.settled_windows import Windows, windows_of
from koop_identify.recording.signals import Signals, Source
from koop_lab.cli.tables import forecast_table, merit_table
from koop_lab.recorded.report import coverage_lines, read
from koop_lab.replay import open_loop
from koop_loop.parameters import LoopParameters
from koopman_lifter.model import KoopmanModel
from koopman_lifter.prediction import Forecast

HORIZONS = (1, 10, 50, 200)  # steps ahead
FEWEST = 10  # windows below which a rank correlation says little


def inspect_on(
    path: Path, model_file: Path, model: KoopmanModel, source: Source, args: argparse.Namespace
) -> str:
    """Return in words how a model does on a recording.

    Raises
    ------
    koop_bag.errors.BagError
        If the bag cannot be read.
    ValueError
        If the model and the recording do not fit together.
    """
    if source.dt is not None and source.dt != model.dt:
        raise ValueError(f"--dt {source.dt:g}: the model was learned at {model.dt:g} s")
    run = read(path, source, model_file)
    signals = run.signals
    recorded = run.parameters.as_ros() if run.parameters is not None else {}
    lifted = open_loop.settings(
        signals.dt, args.params_file, str(model_file),
        [*args.settings, "koopman_lifter.cost=lifted"], recorded,
    )  # fmt: skip
    raw = replace(lifted, lifter=replace(lifted.lifter, cost="raw"))
    name = str(model.provenance.get("variant", "lifted"))
    judged = {name: lifted, "raw": raw}
    found = {name: _windows(signals, made, str(path)) for name, made in judged.items()}
    windows = found[name]
    lines = [
        f"on {path}: {signals.t.size} states ({signals.way})",
        *coverage_lines(run),
        "",
        forecast_table(model, forecast_on(signals, model), "this recording"),
        "",
        "as a cost, which needs no good forecast, with omega_h "
        f"{lifted.lifter.omega_h:g}, omega_l {lifted.lifter.omega_l:g} rad/s and a dwell of "
        f"{lifted.esc.dwell:g} s:",
    ]
    if windows.merit.rank_amplitude is None:
        return "\n".join(
            [*lines, "not to be told: fewer than three settled windows in which r is known, "
             "or nothing changes from one to the other"]
        )  # fmt: skip
    lines += [
        merit_table([(name, found[name].merit) for name in found]),
        f"over {windows.merit.windows} settled windows of {windows.length:.3g} s"
        + (": too few to tell much, record longer" if windows.merit.windows < FEWEST else "")
        + ("" if windows.theta is not None else "; theta is not in the recording, or not named"),
    ]
    return "\n".join(lines)


def _windows(signals: Signals, made: LoopParameters, what: str) -> Windows:
    return windows_of(signals, open_loop.answer(signals, made, f"the state in {what}").r, made)


def forecast_on(signals: Signals, model: KoopmanModel) -> list[dict[str, Any]]:
    """Return the errors of a model's forecast on a recording; see Forecast.result."""
    forecast = Forecast(model, HORIZONS)
    usable: NDArray[np.bool_] = np.asarray(np.isfinite(signals.x).all(axis=1))
    cut = signals.begins | ~usable | np.insert(~usable[:-1], 0, True)
    for piece in np.split(np.arange(usable.size), np.flatnonzero(cut)):
        piece = piece[usable[piece]]
        if piece.size > model.delays.depth:
            forecast.add(np.ascontiguousarray(signals.x[piece].T), 0)
    return forecast.result()
