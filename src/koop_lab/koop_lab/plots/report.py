"""One page about a recorded run: signals over time, eigenvalues, spectra, cost by theta."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from scipy.signal import spectrogram

matplotlib.use("Agg")  # a file is written: no display is needed or looked for
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from koop_identify.model.settled_windows import Windows
from koop_identify.recording.signals import Signals
from koop_lab.plots.signals import Named, draw_signals, envelope
from koop_lab.plots.views import draw_amplitude_by_theta, draw_cost_by_theta, draw_spectrum, say
from koopman_lifter.model import KoopmanModel

FLOOR = -60.0  # [dB] below the largest value, where the colours of the spectrogram end
SPARSE = 10  # steps a state, above which a gap is not a gap any more
POWER = 0.999  # share of the power that the frequency axis shows
TRANSIENT = 0.04  # share of the run that the axes of state and cost need not fit


def plot_report(
    path: Path,
    run: Signals,
    costs: Named,
    windows: Windows,
    model: KoopmanModel | None,
    theta_star: float | None,
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
    windows : Windows
        Settled windows, with the first of the costs.
    model : KoopmanModel or None
        Its eigenvalues and frequencies are shown.
    theta_star : float or None
        Best theta, a dashed line.
    title : str
        Heading.
    """
    t = run.t
    figure = plt.figure(figsize=(16, 13), layout="constrained")
    figure.suptitle(title)
    grid = figure.add_gridspec(9, 6)
    state = figure.add_subplot(grid[0:2, :4])
    cost = figure.add_subplot(grid[2, :4], sharex=state)
    theta = figure.add_subplot(grid[3, :4], sharex=state)
    channels = dict(zip(run.names, run.x.T, strict=True))
    thetas = {"theta": run.theta} if run.has_theta else {}
    after = t >= t[0] + TRANSIENT * (t[-1] - t[0])
    draw_signals((state, cost, theta), t, channels, costs, thetas, theta_star, after)
    if not run.has_theta:
        say(theta, "theta is not known")
    elif (run.swing < 1.0).any():  # the adaptive law
        _draw_swing(theta.twinx(), t, run.swing)
    picture = figure.add_subplot(grid[4:6, :4], sharex=state)
    _draw_spectrogram(picture, t, run.x[:, 0], run.dt, run.names[0])
    _draw_eigenvalues(figure.add_subplot(grid[:6, 4:]), model)
    draw_spectrum(figure.add_subplot(grid[6:, :2]), run, model)
    draw_cost_by_theta(figure.add_subplot(grid[6:, 2:4]), windows)
    draw_amplitude_by_theta(figure.add_subplot(grid[6:, 4:]), windows, run.names)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _draw_swing(axis: Axes, t: NDArray[np.float64], swing: NDArray[np.float64]) -> None:
    """Draw the adaptive law's step, of 0 to 1, on an axis of its own."""
    envelope(axis, t, swing, "swing", "C2")
    axis.set_ylim(0.0, 1.05)
    axis.set_ylabel("swing", color="C2")


def _draw_spectrogram(
    axis: Axes, t: NDArray[np.float64], y: NDArray[np.float64], dt: float, name: str
) -> None:
    """Draw how the spectrum of a signal changes; what is missing is drawn as a straight line."""
    usable = np.isfinite(y)
    step = np.round(t / dt).astype(np.int64)
    axis.set_ylabel(f"frequency of {name} [Hz]")
    axis.set_xlabel("time [s]")
    present = step[usable]
    if present.size < 64:
        return say(axis, "too short for a spectrogram")
    if present[-1] - present[0] > SPARSE * present.size:
        return say(axis, "too much is missing for a spectrogram")
    grid = np.arange(present[0], present[-1] + 1)
    even = np.interp(grid, present, y[usable])
    length = min(grid.size, max(64, 2 ** int(np.log2(grid.size / 8))), 4096)
    frequency, time, power = spectrogram(
        even, 1.0 / dt, nperseg=length, noverlap=length * 3 // 4, detrend="linear"
    )
    total = np.cumsum(power.sum(axis=1))
    top = max(8, int(np.searchsorted(total, POWER * total[-1])) + 2)
    level = 10.0 * np.log10(np.maximum(power / power.max(), 1e-30)) if power.max() > 0.0 else power
    begin = grid[0] * dt
    mesh = axis.pcolormesh(
        begin + time, frequency[:top], level[:top], vmin=FLOOR, vmax=0.0, shading="nearest"
    )
    axis.figure.colorbar(mesh, ax=axis, label="power density [dB of the largest]", pad=0.01)


def _draw_eigenvalues(axis: Axes, model: KoopmanModel | None) -> None:
    """Draw the eigenvalues of a model in the unit circle."""
    if model is None:
        axis.set_axis_off()
        return say(axis, "no model at hand")
    circle = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 400))
    axis.plot(circle.real, circle.imag, color="grey", linewidth=0.8)
    values, kept = model.eigenvalues, model.kept
    # large rings below small dots: the slow modes lie on top of each other near 1
    for chosen, label, face, size in ((~kept, "left out", "none", 110), (kept, "kept", "C0", 30)):
        x, y = values[chosen].real, values[chosen].imag
        axis.scatter(x, y, s=size, facecolors=face, edgecolors="C0", label=label)
    axis.set_aspect("equal")
    axis.set_title(f"eigenvalues of model {model.model_id}")
    axis.set_xlabel("Re λ")
    axis.set_ylabel("Im λ")
    axis.grid(alpha=0.3)
    axis.legend(loc="lower left")
