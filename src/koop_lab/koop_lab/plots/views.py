"""What to look at before a loop is closed: spectra with modes, cost and amplitude by theta.

Each function draws into axes that it is given.
"""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.signal import welch

from koop_identify.model.settled_windows import Windows
from koop_identify.recording.loaded import pieces
from koop_identify.recording.signals import Signals
from koopman_lifter.model import KoopmanModel

WIDE = 100.0  # ratio of largest to least r above which its axis is logarithmic
SEGMENTS = 8  # of Welch's method
NAMED = 6  # modes whose frequency is written down
DEEP = 1e-8  # of the largest power, below which nothing is drawn


def frequencies(model: KoopmanModel) -> NDArray[np.float64]:
    """Return the frequency of each mode [Hz]: |arg lambda| / (2 pi dt)."""
    return np.asarray(np.abs(np.angle(model.eigenvalues)) / (2.0 * np.pi * model.dt))


def longest_piece(signals: Signals) -> NDArray[np.float64]:
    """Return the states of the longest piece without a gap or a hole, shape (L, n)."""
    cut = signals.begins | ~np.isfinite(signals.x).all(axis=1)
    cut[:1] = True
    longest = max(pieces(cut), key=lambda piece: piece.stop - piece.start, default=slice(0))
    piece = signals.x[longest]
    return np.asarray(piece[np.isfinite(piece).all(axis=1)])


def draw_spectrum(axis: Axes, signals: Signals, model: KoopmanModel | None) -> None:
    """Draw the spectral density of every channel, and where the modes of a model lie."""
    x = longest_piece(signals)
    axis.set_title("spectrum of each channel" + (", modes marked" if model is not None else ""))
    axis.set_xlabel("frequency [Hz]")
    axis.set_ylabel("share of the variance [1/Hz]")
    if x.shape[0] < 64:
        return say(axis, "too short for a spectrum")
    size = max(64, 2 * x.shape[0] // (SEGMENTS + 1))
    least = most = 1.0
    for name, values in zip(signals.names, x.T, strict=True):
        frequency, power = welch(values, 1.0 / signals.dt, nperseg=size, detrend="linear")
        density = power[1:] / (values.var() or 1.0)
        axis.loglog(frequency[1:], density, linewidth=0.9, label=name)
        most = max(most, float(density.max()))
        least = min(least, float(density.min()))
    axis.set_ylim(max(least, DEEP * most), 3.0 * most)
    axis.set_xlim(frequency[1], frequency[-1])
    if model is not None:
        mark_modes(axis, model)
    axis.legend(loc="lower left", fontsize="small")
    axis.grid(alpha=0.3)


def mark_modes(axis: Axes, model: KoopmanModel) -> None:
    """Draw a line at each mode's frequency: kept ones solid, with the frequency; others dotted."""
    where = frequencies(model)
    for kept, style in ((False, "dotted"), (True, "solid")):
        known = np.unique(where[(model.kept == kept) & (where > 0.0)].round(9))
        slow = int(np.count_nonzero((model.kept == kept) & (where == 0.0)))
        label = f"mode {'kept' if kept else 'left out'}" + (f" ({slow} at 0 Hz)" if slow else "")
        for i, value in enumerate(known):
            axis.axvline(
                value, color="C3", linestyle=style, linewidth=0.9, label=None if i else label
            )
        for i, value in enumerate(known[:NAMED] if kept else ()):
            axis.annotate(
                f"{value:.3g}", (value, 1.0), xycoords=("data", "axes fraction"),
                xytext=(2, -10 - 10 * (i % 3)), textcoords="offset points", fontsize="x-small",
                color="C3",
            )  # fmt: skip


def draw_cost_by_theta(axis: Axes, windows: Windows) -> None:
    """Draw the mean cost of each settled window against theta."""
    axis.set_title("r against theta")
    axis.set_ylabel("mean r of a window")
    if _lacks(axis, windows, windows.r):
        return
    assert windows.theta is not None
    positive = windows.r[windows.r > 0.0]
    if positive.size and float(np.nanmax(windows.r)) > WIDE * float(positive.min()):
        axis.set_yscale("log")
    drawn = axis.scatter(windows.theta, windows.r, s=14, c=windows.t, cmap="viridis")
    axis.figure.colorbar(drawn, ax=axis, label="time [s]", pad=0.01)


def draw_amplitude_by_theta(axis: Axes, windows: Windows, names: tuple[str, ...]) -> None:
    """Draw the amplitude of each channel in each settled window against theta."""
    several = len(names) > 1
    axis.set_title(f"oscillation against theta, {windows.t.size} windows of {windows.length:.3g} s")
    axis.set_ylabel("amplitude" + (" over its median" if several else f" of {names[0]}"))
    if _lacks(axis, windows, windows.amplitude[0]):
        return
    assert windows.theta is not None
    for i, (name, values) in enumerate(zip(names, windows.amplitude, strict=True)):
        usual = float(np.nanmedian(values)) or 1.0
        shown = values / usual if several else values
        axis.scatter(windows.theta, shown, s=12, marker="osv^D<>"[i % 7], label=name, alpha=0.7)
    axis.legend(loc="best", fontsize="small")


def say(axis: Axes, text: str) -> None:
    """Write why nothing is drawn."""
    axis.text(0.5, 0.5, text, ha="center", transform=axis.transAxes)


def _lacks(axis: Axes, windows: Windows, values: NDArray[np.float64]) -> bool:
    """Return whether there is nothing to draw, and say why."""
    axis.set_xlabel("theta")
    axis.grid(alpha=0.3)
    if windows.theta is None:
        say(axis, "theta is not in the recording, or not named (--command)")
    elif np.count_nonzero(np.isfinite(values)) < 3:
        say(axis, "fewer than three settled windows")
    else:
        return False
    return True
