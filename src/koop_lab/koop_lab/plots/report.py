"""One page about a recorded run: signals over time, spectra and the modes of its model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.signal import welch

from koop_identify.recording.loaded import list_segments
from koop_identify.recording.signals import Signals
from koop_lab.plots.signals import Named, draw_signals, save
from koopman_lifter.model import KoopmanModel

SEGMENTS = 8  # of Welch's method
NAMED = 6  # modes whose frequency is written down
DEEP = 1e-8  # of the largest power of a spectrum, below which nothing is drawn
TRANSIENT = 0.04  # share of the run that the axes of state and cost need not fit


def plot_report(
    path: Path,
    run: Signals,
    costs: Named,
    model: KoopmanModel | None,
    theta_star: float | tuple[float, ...] | None,
    title: str,
) -> None:
    """Draw a run.

    Parameters
    ----------
    path : Path
        File to write; the ending chooses the format.
    run : Signals
        What to draw.
    costs : mapping of str to ndarray, shape (M,)
        One or two, by their names.
    model : KoopmanModel or None
        Its frequencies are marked.
    theta_star : float or None
        Best theta, a dashed line.
    title : str
        Heading.
    """
    t = run.t
    figure = plt.figure(figsize=(16, 9), layout="constrained")
    figure.suptitle(title)
    grid = figure.add_gridspec(4, 6)
    state = figure.add_subplot(grid[0:2, :4])
    cost = figure.add_subplot(grid[2, :4], sharex=state)
    theta = figure.add_subplot(grid[3, :4], sharex=state)
    theta.set_xlabel("time [s]")
    channels = dict(zip(run.names, run.x.T, strict=True))
    thetas = {"theta": run.theta} if run.has_theta else {}
    after = t >= t[0] + TRANSIENT * (t[-1] - t[0])
    draw_signals((state, cost, theta), t, channels, costs, thetas, theta_star, after)
    if not run.has_theta:
        say(theta, "theta is not known")
    _draw_spectrum(figure.add_subplot(grid[:, 4:]), run, model)
    save(figure, path)


def frequencies(model: KoopmanModel) -> NDArray[np.float64]:
    """Return the frequency of each mode [Hz]: |arg lambda| / (2 pi dt)."""
    return np.asarray(np.abs(np.angle(model.eigenvalues)) / (2.0 * np.pi * model.dt))


def _longest_segment(signals: Signals) -> NDArray[np.float64]:
    """Return the states of the longest segment without a gap or a hole, shape (L, n)."""
    cut = signals.begins | ~np.isfinite(signals.x).all(axis=1)
    cut[:1] = True
    longest = max(
        list_segments(cut), key=lambda segment: segment.stop - segment.start, default=slice(0)
    )
    segment = signals.x[longest]
    return np.asarray(segment[np.isfinite(segment).all(axis=1)])


def _draw_spectrum(axis: Axes, signals: Signals, model: KoopmanModel | None) -> None:
    """Draw the spectral density of every channel, and where the modes of a model lie."""
    x = _longest_segment(signals)
    axis.set_title("spectrum of each channel" + (", modes marked" if model is not None else ""))
    axis.set_xlabel("frequency [Hz]")
    axis.set_ylabel("share of the variance [1/Hz]")
    if x.shape[0] < 64:
        return say(axis, "too short for a spectrum")
    size = max(64, 2 * x.shape[0] // (SEGMENTS + 1))
    most = 1.0
    for name, values in zip(signals.names, x.T, strict=True):
        frequency, power = welch(values, 1.0 / signals.dt, nperseg=size, detrend="linear")
        density = power[1:] / (values.var() or 1.0)
        axis.loglog(frequency[1:], density, linewidth=0.9, label=name)
        most = max(most, float(density.max()))
    axis.set_ylim(DEEP * most, 3.0 * most)
    axis.set_xlim(frequency[1], frequency[-1])
    if model is not None:
        mark_modes(axis, model)
    axis.legend(loc="lower left", fontsize="small")
    axis.grid(alpha=0.3)


def mark_modes(axis: Axes, model: KoopmanModel) -> None:
    """Draw a line at each mode's frequency: kept ones solid, with the frequency; others dotted."""
    where = frequencies(model)
    for kept, style in ((False, "dotted"), (True, "solid")):
        marked = np.unique(where[(model.kept == kept) & (where > 0.0)].round(9))
        slow = int(np.count_nonzero((model.kept == kept) & (where == 0.0)))
        label = f"mode {'kept' if kept else 'left out'}" + (f" ({slow} at 0 Hz)" if slow else "")
        for i, value in enumerate(marked):
            axis.axvline(
                value, color="C3", linestyle=style, linewidth=0.9, label=None if i else label
            )
        for i, value in enumerate(marked[:NAMED] if kept else ()):
            axis.annotate(
                f"{value:.3g}", (value, 1.0), xycoords=("data", "axes fraction"),
                xytext=(2, -10 - 10 * (i % 3)), textcoords="offset points", fontsize="x-small",
                color="C3",
            )  # fmt: skip


def say(axis: Axes, text: str) -> None:
    """Write why nothing is drawn."""
    axis.text(0.5, 0.5, text, ha="center", transform=axis.transAxes)
