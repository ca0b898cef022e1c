"""``koop train --compare``: which cost would follow the oscillation of a recorded rig best."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.reader import BagReader
from koop_core.text_table import table
from koop_identify.model.energies import band_energy, energies
from koop_identify.model.from_bags import BagTraining, built, contrasted, load_bags
from koop_identify.model.merit import (
    Merit,
    cut_windows,
    detected,
    merit,
    oscillation,
    settled_windows,
)
from koop_identify.model.windows import PERIODS, SKIP, period_of, usual_rest
from koop_identify.recording.loaded import Loaded, pieces
from koop_identify.recording.recorded_parameters import recorded_values
from koop_identify.recording.samples import state_names
from koopman_lifter.config import LifterConfig
from koopman_lifter.delays import Delays, spacing_for
from koopman_lifter.edmd import BLOCK, Gram
from koopman_lifter.model import KoopmanModel
from koopman_lifter.observables import Monomials
from relay_esc.config import EscConfig

matplotlib.use("Agg")  # a file is written: no display is needed or looked for
from matplotlib import pyplot as plt

BAND_LIMITED = "band-limited energy"  # for comparison: the lifter has no such cost
DELAYS = 8  # samples of the candidates with delays, unless told otherwise
PART = 2048  # samples in a row, where not all are learned from
REST = 0.6  # of the time in which theta rests, that may pass before a window


@dataclass(frozen=True)
class Candidate:
    """A cost on the recording.

    Attributes
    ----------
    name : str
        In words.
    options : str
        With which ``koop train`` makes its model; empty where none is needed.
    r : ndarray, shape (K, L)
        After the detector, window by window; empty where the cost cannot be made.
    merit : Merit or None
        Its figures.
    problem : str
        Why it cannot be made.
    """

    name: str
    options: str
    r: NDArray[np.float64]
    merit: Merit | None
    problem: str = ""


@dataclass(frozen=True)
class Comparison:
    """All candidates on the same windows.

    Attributes
    ----------
    candidates : list of Candidate
        In the order of the table.
    theta, amplitude : ndarray, shape (K,)
        Of the windows; theta is empty where it is not known.
    window, period : float
        Length of a window and period of the oscillation [s].
    lifter, esc : LifterConfig, EscConfig
        Whose detector and dwell time count.
    """

    candidates: list[Candidate]
    theta: NDArray[np.float64]
    amplitude: NDArray[np.float64]
    window: float
    period: float
    lifter: LifterConfig
    esc: EscConfig


def compare(paths: Sequence[Path], training: BagTraining) -> Comparison:
    """Make every candidate cost from the training part of the bags and judge it on all of them.

    The recordings are held in memory.

    Raises
    ------
    koop_bag.errors.BagError
        If a bag cannot be read or lacks the topic or a field.
    ValueError
        If the bags do not fit together or hold no window to judge by.
    """
    loaded, training = load_bags(paths, training)
    dt = training.dt
    assert dt is not None
    namespace = training.state.topic.rpartition("/")[0] or "/"
    with BagReader(paths[-1]) as bag:
        recorded = recorded_values(bag, paths[-1], namespace)
    lifter = replace(LifterConfig(**_own(LifterConfig, recorded.get("koopman_lifter", {}))), dt=dt)
    esc = replace(EscConfig(**_own(EscConfig, recorded.get("relay_esc", {}))), dt=dt)
    period = period_of(loaded, dt)
    settling = lifter.detector_params().settling * dt
    skip = min(max(SKIP * period, settling), REST * usual_rest(loaded.theta, dt))
    starts, length = settled_windows(loaded.theta, loaded.begins, dt, skip, PERIODS * period)
    if starts.size < 3:
        raise ValueError(
            f"{starts.size} windows of {length * dt:.3g} s in which theta rests: nothing to judge "
            "a cost by; record longer, while theta moves over its range and rests for some "
            f"periods (of about {period:.3g} s) at each value"
        )
    amplitude = oscillation(loaded.x, starts, length)
    middle = None
    if loaded.theta is not None:
        middle = cut_windows(loaded.theta, starts, length).mean(axis=1)
    judged = []
    for cost in costs(loaded, training, period):
        name, options = cost.name, cost.options
        if cost.y_out is None:
            empty = np.empty((0, length))
            judged.append(Candidate(name, options, empty, None, cost.problem))
            continue
        r = detected(cost.y_out, loaded.begins, lifter.detector_params())
        windows = cut_windows(r, starts, length)
        figures = merit(windows, amplitude, middle, dt, esc.dwell)
        judged.append(Candidate(name, options, windows, figures))
    theta_of_windows = np.empty(0) if middle is None else middle
    return Comparison(judged, theta_of_windows, amplitude, length * dt, period, lifter, esc)


def _own(kind: Any, given: dict[str, Any]) -> dict[str, Any]:
    """Return those of a node's recorded parameters that a configuration has."""
    return {item.name: given[item.name] for item in fields(kind) if item.name in given}


class Cost(NamedTuple):
    """A candidate cost on a recording.

    Attributes
    ----------
    name : str
        In words.
    training : BagTraining or None
        With which its model is learned; None where the cost needs none.
    model : KoopmanModel or None
        Learned from the training part.
    y_out : ndarray, shape (M,), or None
        Energies; None if the cost cannot be made.
    problem : str
        Why it cannot be made.
    """

    name: str
    training: BagTraining | None
    model: KoopmanModel | None
    y_out: NDArray[np.float64] | None
    problem: str = ""

    @property
    def options(self) -> str:
        """With which ``koop train`` makes its model; empty where none is needed."""
        if self.training is None:
            return ""
        own, words = self.training, ""
        if own.delays > 1:
            words = f" --delays {own.delays} --spacing {own.spacing:g}"
        return words + (" --contrast" if own.contrast else "")


def costs(
    loaded: Loaded, training: BagTraining, period: float, most: int | None = None
) -> Iterator[Cost]:
    """Yield every candidate, learned from the training part of a recording.

    ``period`` is that of the oscillation [s]; modes are learned from ``most`` samples, spread over
    the recording, or from all.
    """
    x, begins, dt = loaded.x, loaded.begins, training.dt
    assert dt is not None
    yield Cost("raw", None, None, energies(None, x, begins))
    yield Cost(BAND_LIMITED, None, None, band_energy(x, begins, dt, period))
    n = x.shape[0]
    count = training.delays if training.delays > 1 else DELAYS
    spacing = spacing_for(period, count) if training.spacing is None else training.spacing
    for delays in (Delays(n), Delays.spaced(n, count, spacing, dt)):
        words, own = "", replace(training, delays=1, spacing=None, contrast=False)
        if delays.count > 1:
            own = replace(own, delays=count, spacing=delays.every * dt)
            words = f", {count} samples {delays.every * dt:g} s apart"
        model: KoopmanModel | None = None
        problem = ""
        try:
            model = _learned(loaded, training, delays, most)
        except ValueError as error:
            problem = str(error)
        yield _of(f"lifted{words}", own, model, loaded, problem)
        told: KoopmanModel | None = None
        try:
            told = None if model is None else contrasted(model, loaded, period)
        except ValueError as error:
            problem = str(error)
        yield _of(
            f"contrast{words}", replace(own, contrast=True, period=period), told, loaded, problem
        )


def _of(
    name: str, training: BagTraining, model: KoopmanModel | None, loaded: Loaded, problem: str
) -> Cost:
    if model is None:
        return Cost(name, training, None, None, problem)
    return Cost(name, training, model, energies(model, loaded.x, loaded.begins))


def _learned(
    loaded: Loaded, training: BagTraining, delays: Delays, most: int | None
) -> KoopmanModel:
    """Return the model of the training part, or of ``most`` of its samples."""
    assert training.dt is not None
    gram = Gram.empty(Monomials(delays.n, training.degree_for(delays)))
    share = 1.0 if most is None else min(1.0, most / loaded.x.shape[1])
    length = BLOCK if share == 1.0 else PART
    for piece in pieces(loaded.begins):
        if not loaded.held_out[piece.start]:
            for begin in range(piece.start, piece.stop, round(length / share)):
                # embedded, it is as many times as large as there are delays
                end = min(begin + length + delays.depth, piece.stop)
                gram.add_trajectory(delays.embed(loaded.x[:, begin:end]))
    names = training.names or state_names(training.state, delays.channels)
    return built(gram, training, names, {}, delays)


def described(found: Comparison) -> str:
    """Return the comparison as a table and what to make of it."""
    by_theta = found.theta.size > 0
    header = ["cost", "order", "right", "SNR [dB]"]
    if by_theta:
        header = ["cost", "order by amplitude", "by theta", "least at theta", *header[2:]]
    rows = []
    for candidate in found.candidates:
        figures = candidate.merit
        if figures is None:
            rows.append([candidate.name, *["-"] * (len(header) - 1)])
            continue
        numbers = [figures.rank_amplitude]
        if by_theta:
            numbers += [figures.rank_theta, figures.theta_least_r]
        cells = ["-" if value is None else f"{value:.2f}" for value in numbers]
        right = "-" if figures.right is None else f"{100.0 * figures.right:.0f} %"
        rows.append([candidate.name, *cells, right, _decibels(figures.snr)])
    least = next(
        (c.merit.theta_least_amplitude for c in found.candidates if c.merit is not None), None
    )
    lines = [
        f"{found.amplitude.size} windows of {found.window:.3g} s, the oscillation's period is "
        f"about {found.period:.3g} s; detector omega_h = {found.lifter.omega_h:g}, omega_l = "
        f"{found.lifter.omega_l:g} rad/s, dwell {found.esc.dwell:g} s",
        "",
        table(header, rows),
        "",
        "order: rank correlation of r with the amplitude of the oscillation"
        + (", and with the distance of theta from where that is least" if by_theta else ""),
        f"right: how often r over one dwell tells which of two "
        f"{'thetas one move apart' if by_theta else 'windows'} is better; 50 % is chance",
    ]
    if by_theta and least is not None:
        lines.append(f"the amplitude is least at theta = {least:.2f}")
    lines += [f"{c.name}: {c.problem}" for c in found.candidates if c.problem]
    best = max(
        (c for c in found.candidates if c.merit is not None and c.merit.right is not None),
        key=lambda c: c.merit.right if c.merit and c.merit.right else 0.0,
        default=None,
    )
    if best is not None:
        how = f"koop train ...{best.options}" if best.options else NO_MODEL.get(best.name, "")
        lines.append(f"most often right: {best.name}" + (f" ({how})" if how else ""))
    return "\n".join(lines)


NO_MODEL = {
    "raw": "the lifter's parameter cost: raw needs no model",
    BAND_LIMITED: "for comparison: the lifter has no such cost",
}


def _decibels(snr: float | None) -> str:
    if snr is None:
        return "-"
    return f"{20.0 * np.log10(snr):.0f}" if snr > 0.0 else "none"


def draw(found: Comparison, path: Path, title: str) -> None:
    """Draw r against theta, or against the amplitude where theta is not known."""
    shown = [c for c in found.candidates if c.merit is not None]
    columns = 3
    rows = -(-len(shown) // columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(4.0 * columns, 3.0 * rows), layout="constrained", squeeze=False
    )
    figure.suptitle(title)
    across, label = found.amplitude, "amplitude"
    if found.theta.size:
        across, label = found.theta, "theta"
    for axis, candidate in zip(axes.flat, shown, strict=False):
        with np.errstate(invalid="ignore"):
            r = np.array([row[np.isfinite(row)].mean() if np.isfinite(row).any() else np.nan
                          for row in candidate.r])  # fmt: skip
        points = axis.scatter(across, r, s=12, c=found.amplitude, cmap="viridis")
        if (r[np.isfinite(r)] > 0.0).all():
            axis.set_yscale("log")
        axis.set_title(candidate.name, fontsize=9)
        axis.set_xlabel(label)
        axis.set_ylabel("r, mean of a window")
        if found.theta.size:
            figure.colorbar(points, ax=axis, label="amplitude")
    for axis in axes.flat[len(shown) :]:
        axis.set_visible(False)
    figure.savefig(path, dpi=120)
    plt.close(figure)
