"""State, cost and control input over time: the paper's figure of a run, and part of a report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray

matplotlib.use("Agg")  # a file is written: no display is needed or looked for
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from koop_core.errors import InputError
from koop_identify.recording.passes import each_knob
from koop_loop.metrics import LOGGING_START
from koop_loop.thinning import thin
from koop_loop.training import STATE_NAMES

POINTS = 4000  # columns of the drawing; more cannot be seen
Named = Mapping[str, NDArray[np.float64]]


def plot_signals(
    path: Path,
    t: NDArray[np.float64],
    states: Named,
    r: NDArray[np.float64],
    theta: NDArray[np.float64],
    title: str,
    theta_star: float | tuple[float, ...],
) -> None:
    """Draw a run of the simulated plant as in figures 5 and 6 of the paper.

    Parameters
    ----------
    path : Path
        File to write; the ending chooses the format.
    t : ndarray, shape (M,)
        Time [s].
    states : mapping of str to ndarray, shape (M,)
        By their labels.
    r, theta : ndarray, shape (M,)
        Cost and control input; theta of n > 1 knobs of shape (M, n).
    title : str
        Heading.
    theta_star : float, or one for each knob
        Optimal control input, a dashed line.
    """
    figure, axes = plt.subplots(3, 1, sharex=True, figsize=(8, 7), layout="constrained")
    figure.suptitle(title)
    # the initial transient, which the paper leaves out, is orders of magnitude larger
    after = t >= LOGGING_START if t[-1] > LOGGING_START else t >= t[0]
    cost = {"cost r (arbitrary unit:\nonly its slope counts)": r}
    draw_signals(axes, t, states, cost, {"theta": theta}, theta_star, after)
    axes[2].set_xlabel("time [s]")
    save(figure, path)


def true_states(truth: NDArray[np.float64]) -> Named:
    """Return the states of our plant, shape (M, 2), by their labels."""
    return {f"true {name}": x for name, x in zip(STATE_NAMES, truth.T, strict=True)}


def save(figure: Figure, path: Path) -> None:
    """Write a figure and close it.

    Raises
    ------
    koop_core.errors.InputError
        If the ending of the file is not a format.
    """
    formats = figure.canvas.get_supported_filetypes()
    ending = path.suffix.lstrip(".").lower()
    if ending and ending not in formats:
        raise InputError(f"{path}: '{ending}' is not a format: choose png, svg or pdf")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def draw_signals(
    axes: Sequence[Axes],
    t: NDArray[np.float64],
    channels: Named,
    costs: Named,
    thetas: Named,
    theta_star: float | tuple[float, ...] | None,
    after: NDArray[np.bool_],
) -> None:
    """Draw states, costs and control inputs into three axes; the first two fit what is ``after``.

    Each of two costs has an axis of its own.
    """
    state, cost, theta = axes
    for axis, label, curves in (
        (state, "state", channels),
        (theta, "control input θ", thetas),
    ):
        for name, values in curves.items():
            for each, column in each_knob(name, values).items():
                envelope(axis, t, column, each)
        axis.set_ylabel(label)
    fit(state, np.stack([values[after] for values in channels.values()]))
    state.legend(loc="upper right", ncols=max(4, len(channels)), fontsize="small")
    for best in [] if theta_star is None else np.atleast_1d(theta_star):
        theta.axhline(best, linestyle="--", color="black", linewidth=1.0)
        theta.annotate("θ*", (t[-1], best), xytext=(3, 0), textcoords="offset points", va="center")
    for i, (name, values) in enumerate(costs.items()):
        axis = cost.twinx() if i else cost
        axis.set_ylabel(name, color=f"C{3 * i}")
        if np.isfinite(values[after]).any():
            envelope(axis, t, values, name, f"C{3 * i}")
            fit(axis, values[after])
    for axis in axes:
        axis.grid(alpha=0.3)
        axis.margins(x=0.0)


def fit(axis: Axes, y: NDArray[np.float64]) -> None:
    """Let the vertical axis fit the values, a little wider."""
    low, high = float(np.nanmin(y)), float(np.nanmax(y))
    margin = 0.05 * (high - low) or 1.0
    axis.set_ylim(low - margin, high + margin)


def envelope(
    axis: Axes,
    t: NDArray[np.float64],
    y: NDArray[np.float64],
    label: str,
    color: str | None = None,
) -> None:
    """Plot a signal; a long one as the band between its extremes, so that no peak is lost."""
    x, edges = thin(t, y, POINTS)
    width = 0.8 if x is t else 0.6
    axis.plot(x, edges, linewidth=width, label=label, color=color)
