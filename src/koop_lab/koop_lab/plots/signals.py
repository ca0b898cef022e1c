"""State, cost and control input over time: the paper's figure of a run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray

matplotlib.use("Agg")  # a file is written: no display is needed or looked for
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from koop_core.errors import InputError
from koop_identify.recording.passes import each_knob
from koop_loop.thinning import thin
from koop_loop.training import STATE_NAMES

POINTS = 4000  # columns of the drawing; more cannot be seen
TRANSIENT = 0.04  # share of the run, 100 s of the paper, that axes of state and cost need not fit
COST = "cost r (arbitrary unit:\nonly its slope counts)"
Named = Mapping[str, NDArray[np.float64]]


def plot_signals(
    path: Path,
    t: NDArray[np.float64],
    states: Named,
    costs: Named,
    thetas: Named,
    title: str,
    theta_star: float | tuple[float, ...] | None,
) -> None:
    """Draw a run as in figures 5 and 6 of the paper.

    Parameters
    ----------
    path : Path
        File to write; the ending chooses the format.
    t : ndarray, shape (M,)
        Time [s].
    states : mapping of str to ndarray, shape (M,)
        By their labels.
    costs : mapping of str to ndarray, shape (M,)
        One or two, each with an axis of its own.
    thetas : mapping of str to ndarray, shape (M,)
        Control input, of n > 1 knobs of shape (M, n); empty: it is not known.
    title : str
        Heading.
    theta_star : float, one for each knob, or None
        Optimal control input, a dashed line.

    Raises
    ------
    koop_core.errors.InputError
        If the ending of the file is not a format.
    """
    figure, axes = plt.subplots(3, 1, sharex=True, figsize=(8, 7), layout="constrained")
    formats = figure.canvas.get_supported_filetypes()
    ending = path.suffix.lstrip(".").lower()
    if ending and ending not in formats:
        raise InputError(f"{path}: '{ending}' is not a format: choose png, svg or pdf")
    figure.suptitle(title)
    state, cost, theta = axes
    after = t >= t[0] + TRANSIENT * (t[-1] - t[0])
    for axis, label, curves in ((state, "state", states), (theta, "control input θ", thetas)):
        for name, values in curves.items():
            for each, column in each_knob(name, values).items():
                _envelope(axis, t, column, each)
        axis.set_ylabel(label)
    _fit(state, np.stack([values[after] for values in states.values()]))
    state.legend(loc="upper right", ncols=max(4, len(states)), fontsize="small")
    if not thetas:
        theta.text(0.5, 0.5, "theta is not known", ha="center", transform=theta.transAxes)
    for best in [] if theta_star is None else np.atleast_1d(theta_star):
        theta.axhline(best, linestyle="--", color="black", linewidth=1.0)
        theta.annotate("θ*", (t[-1], best), xytext=(3, 0), textcoords="offset points", va="center")
    for i, (name, values) in enumerate(costs.items()):
        axis = cost.twinx() if i else cost
        axis.set_ylabel(name, color=f"C{3 * i}")
        _envelope(axis, t, values, name, f"C{3 * i}")
        _fit(axis, values[after])
    for axis in axes:
        axis.grid(alpha=0.3)
        axis.margins(x=0.0)
    theta.set_xlabel("time [s]")
    figure.savefig(path, dpi=110, format=ending or "png")
    plt.close(figure)


def true_states(truth: NDArray[np.float64]) -> Named:
    """Return the states of our plant, shape (M, 2), by their labels."""
    return {f"true {name}": x for name, x in zip(STATE_NAMES, truth.T, strict=True)}


def _fit(axis: Axes, y: NDArray[np.float64]) -> None:
    """Let the vertical axis fit the values that are there, a little wider."""
    y = y[np.isfinite(y)]
    if y.size:
        low, high = float(y.min()), float(y.max())
        margin = 0.05 * (high - low) or 1.0
        axis.set_ylim(low - margin, high + margin)


def _envelope(
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
