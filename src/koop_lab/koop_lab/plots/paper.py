"""The paper's three-panel figure of a run: state, cost, control input."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray

matplotlib.use("Agg")  # a file is written: no display is needed or looked for
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from koop_loop.metrics import LOGGING_START
from koop_loop.thinning import extremes

POINTS = 4000  # columns of the drawing; more cannot be seen


def plot_run(
    path: Path,
    t: NDArray[np.float64],
    state: NDArray[np.float64],
    r: NDArray[np.float64],
    theta: NDArray[np.float64],
    theta_star: float,
    title: str,
) -> None:
    """Draw a run as in figures 5 and 6 of the paper.

    The axes of state and cost fit what comes after the initial transient, which the paper leaves
    out and which is orders of magnitude larger.

    Parameters
    ----------
    path : Path
        File to write; the ending chooses the format.
    t : ndarray, shape (M,)
        Time [s].
    state : ndarray, shape (M,) or (M, n)
        State to show.
    r, theta : ndarray, shape (M,)
        Cost and control input.
    theta_star : float
        Optimal control input, a dashed line.
    title : str
        Heading.
    """
    figure, axes = plt.subplots(3, 1, sharex=True, figsize=(8, 7), layout="constrained")
    figure.suptitle(title)
    columns = state.reshape(t.size, -1)
    for i, name in enumerate(("x", "y") if columns.shape[1] == 2 else map(str, range(99))):
        if i < columns.shape[1]:
            envelope(axes[0], t, columns[:, i], name)
    axes[0].set_ylabel("state")
    after = t >= LOGGING_START if t[-1] > LOGGING_START else t >= t[0]
    fit(axes[0], columns[after])
    fit(axes[1], r[after])
    axes[0].legend(loc="upper right", ncols=2)
    envelope(axes[1], t, r, "r")
    axes[1].set_ylabel("cost r")
    envelope(axes[2], t, theta, "theta")
    axes[2].axhline(theta_star, linestyle="--", color="black", linewidth=1.0)
    axes[2].annotate(
        "θ*", (t[-1], theta_star), xytext=(3, 0), textcoords="offset points", va="center"
    )
    axes[2].set_ylabel("control input θ")
    axes[2].set_xlabel("time [s]")
    save(figure, axes, path)


def save(figure: Figure, axes: Iterable[Axes], path: Path) -> None:
    """Write a figure of signals over time, and let go of it."""
    for axis in axes:
        axis.grid(alpha=0.3)
        axis.margins(x=0.0)
    figure.savefig(path, dpi=110)
    plt.close(figure)


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
    block = -(-t.size // POINTS)
    if block == 1:
        axis.plot(t, y, linewidth=0.8, label=label, color=color)
        return
    edges = np.stack(extremes(y, block), axis=1)
    twice = np.repeat(t[::block][: len(edges)], 2)
    axis.plot(twice, edges.ravel(), linewidth=0.6, label=label, color=color)
