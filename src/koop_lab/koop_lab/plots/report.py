"""One page about a recorded run: signals over time, eigenvalues, spectra, cost by theta."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
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
from koop_lab.plots.paper import envelope, fit
from koop_lab.plots.views import draw_amplitude_by_theta, draw_cost_by_theta, draw_spectrum
from koopman_lifter.model import KoopmanModel

FLOOR = -60.0  # [dB] below the largest value, where the colours of the spectrogram end
SPARSE = 10  # steps a state, above which a gap is not a gap any more
POWER = 0.999  # share of the power that the frequency axis shows
TRANSIENT = 0.04  # share of the run that the axes of state and cost need not fit


@dataclass(frozen=True)
class Cost:
    """A cost over time, and its name."""

    r: NDArray[np.float64]
    name: str


def plot_report(
    path: Path,
    run: Signals,
    costs: Sequence[Cost],
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
    costs : sequence of Cost
        One or two; each has an axis of its own.
    windows : Windows
        Settled windows, with the first of the costs.
    model : KoopmanModel or None
        Its eigenvalues and frequencies are shown.
    theta_star : float or None
        Best theta, a dashed line.
    title : str
        Heading.
    """
    t, dt, n = run.t, run.dt, run.x.shape[1]
    figure = plt.figure(figsize=(16, 13), layout="constrained")
    figure.suptitle(title)
    grid = figure.add_gridspec(9, 6)
    state = figure.add_subplot(grid[0:2, :4])
    cost = figure.add_subplot(grid[2, :4], sharex=state)
    theta = figure.add_subplot(grid[3, :4], sharex=state)
    after = t >= t[0] + TRANSIENT * (t[-1] - t[0])
    for name, values in zip(run.names, run.x.T, strict=True):
        envelope(state, t, values, name)
    state.legend(loc="upper right", ncols=max(4, n))
    fit(state, run.x[after])
    draw_costs(cost, t, after, costs)
    if run.has_theta:
        envelope(theta, t, run.theta, "theta")
        if (run.swing < 1.0).any():  # the adaptive law
            draw_swing(theta.twinx(), t, run.swing)
    else:
        theta.text(0.5, 0.5, "theta is not known", ha="center", transform=theta.transAxes)
    if theta_star is not None:
        theta.axhline(theta_star, linestyle="--", color="black", linewidth=1.0)
    for axis, label in ((state, "measured state"), (theta, "theta")):
        axis.set_ylabel(label)
    for axis in (state, cost, theta):
        axis.grid(alpha=0.3)
        axis.margins(x=0.0)
    picture = figure.add_subplot(grid[4:6, :4], sharex=state)
    draw_spectrogram(picture, t, run.x[:, 0], dt, run.names[0])
    plane, rates = figure.add_subplot(grid[:3, 4:]), figure.add_subplot(grid[3:6, 4:])
    if model is None:
        for axis in (plane, rates):
            axis.set_axis_off()
        plane.text(0.5, 0.5, "no model at hand", ha="center", transform=plane.transAxes)
    else:
        draw_eigenvalues(plane, rates, model)
    draw_spectrum(figure.add_subplot(grid[6:, :2]), run, model)
    draw_cost_by_theta(figure.add_subplot(grid[6:, 2:4]), windows)
    draw_amplitude_by_theta(figure.add_subplot(grid[6:, 4:]), windows, run.names)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def draw_swing(axis: Axes, t: NDArray[np.float64], swing: NDArray[np.float64]) -> None:
    """Draw the adaptive law's step, of 0 to 1, on an axis of its own."""
    envelope(axis, t, swing, "swing", "C2")
    axis.set_ylim(0.0, 1.05)
    axis.set_ylabel("swing", color="C2")


def draw_costs(
    axis: Axes, t: NDArray[np.float64], after: NDArray[np.bool_], costs: Sequence[Cost]
) -> None:
    """Draw one or two costs over time, each with an axis of its own."""
    for i, (cost, own) in enumerate(zip(costs, (axis, axis.twinx()), strict=False)):
        if not np.isfinite(cost.r[after]).any():
            own.text(0.5, 0.5, f"{cost.name}: none", ha="center", transform=own.transAxes)
            continue
        envelope(own, t, cost.r, cost.name, f"C{3 * i}")
        fit(own, cost.r[after])
        own.set_ylabel("cost r", color=f"C{3 * i}")
        own.legend(loc=("upper right", "upper left")[i], fontsize="small")
    if len(costs) == 1:
        axis.figure.axes[-1].set_axis_off()


def draw_spectrogram(
    axis: Axes, t: NDArray[np.float64], y: NDArray[np.float64], dt: float, name: str
) -> None:
    """Draw how the spectrum of a signal changes; what is missing is drawn as a straight line."""
    usable = np.isfinite(y)
    step = np.round(t / dt).astype(np.int64)
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
