"""One page about a recorded run: its signals, their spectrogram, the model's eigenvalues."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from scipy.signal import spectrogram

matplotlib.use("Agg")  # a file is written: no display is needed or looked for
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from koop_lab.plots.paper import envelope, fit
from koop_lab.recorded.signals import Signals
from koopman_lifter.model import KoopmanModel

FLOOR = -60.0  # [dB] below the largest value, where the colours of the spectrogram end
SPARSE = 10  # steps a state, above which a gap is not a gap any more
POWER = 0.999  # share of the power that the frequency axis shows
TRANSIENT = 0.04  # share of the run that the axes of state and cost need not fit


def plot_report(
    path: Path,
    run: Signals,
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
    model : KoopmanModel or None
        Its eigenvalues are shown.
    theta_star : float or None
        Best theta, a dashed line.
    title : str
        Heading.
    """
    t, dt, n = run.t, run.dt, run.x.shape[1]
    figure = plt.figure(figsize=(13, 9), layout="constrained")
    figure.suptitle(title)
    grid = figure.add_gridspec(6, 3)
    state = figure.add_subplot(grid[0:2, :2])
    cost = figure.add_subplot(grid[2, :2], sharex=state)
    theta = figure.add_subplot(grid[3, :2], sharex=state)
    after = t >= t[0] + TRANSIENT * (t[-1] - t[0])
    names = model.state_names if model is not None and len(model.state_names) == n else None
    for i in range(n):
        envelope(state, t, run.x[:, i], names[i] if names else f"x[{i}]")
    state.legend(loc="upper right", ncols=4)
    fit(state, run.x[after])
    envelope(cost, t, run.r, "r")
    fit(cost, run.r[after])
    envelope(theta, t, run.theta, "theta")
    if theta_star is not None:
        theta.axhline(theta_star, linestyle="--", color="black", linewidth=1.0)
    for axis, label in ((state, "measured state"), (cost, "cost r"), (theta, "theta")):
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
        axis.margins(x=0.0)
    picture = figure.add_subplot(grid[4:, :2], sharex=state)
    draw_spectrogram(picture, run.step, run.x[:, 0], dt, names[0] if names else "x[0]")
    plane, rates = figure.add_subplot(grid[:3, 2]), figure.add_subplot(grid[3:, 2])
    if model is None:
        for axis in (plane, rates):
            axis.set_axis_off()
        plane.text(0.5, 0.5, "no model at hand", ha="center", transform=plane.transAxes)
    else:
        draw_eigenvalues(plane, rates, model)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def draw_spectrogram(
    axis: Axes, step: NDArray[np.int64], y: NDArray[np.float64], dt: float, name: str
) -> None:
    """Draw how the spectrum of a signal changes; what is missing is drawn as a straight line."""
    usable = np.isfinite(y)
    axis.set_ylabel(f"frequency of {name} [Hz]")
    axis.set_xlabel("time [s]")
    known, problem = step[usable], ""
    if known.size < 64:
        problem = "too short for a spectrogram"
    elif known[-1] - known[0] > SPARSE * known.size:
        problem = "too much is missing for a spectrogram"
    if problem:
        axis.text(0.5, 0.5, problem, ha="center", transform=axis.transAxes)
        return
    grid = np.arange(known[0], known[-1] + 1)
    even = np.interp(grid, known, y[usable])
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


def draw_eigenvalues(plane: Axes, rates: Axes, model: KoopmanModel) -> None:
    """Draw the eigenvalues in the unit circle, and as frequencies and rates of decay."""
    values, kept = model.eigenvalues, model.kept
    circle = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 400))
    plane.plot(circle.real, circle.imag, color="grey", linewidth=0.8)
    with np.errstate(divide="ignore"):
        continuous = np.log(values) / model.dt
    # large rings below small dots: the slow modes lie on top of each other near 1
    for chosen, label, face, size in ((~kept, "left out", "none", 110), (kept, "kept", "C0", 30)):
        for axis, x, y in (
            (plane, values.real, values.imag),
            (rates, continuous.real, continuous.imag / (2.0 * np.pi)),
        ):
            axis.scatter(
                x[chosen], y[chosen], s=size, facecolors=face, edgecolors="C0", label=label
            )
    plane.set_aspect("equal")
    plane.set_title(f"eigenvalues of model {model.model_id}")
    plane.set_xlabel("Re λ")
    plane.set_ylabel("Im λ")
    rates.axvline(0.0, color="grey", linewidth=0.8)
    rates.set_xlabel("growth rate Re ln λ / Δt [1/s]")
    rates.set_ylabel("frequency Im ln λ / (2π Δt) [Hz]")
    for axis in (plane, rates):
        axis.grid(alpha=0.3)
    plane.legend(loc="lower left")
