"""A recording in settled windows: theta, amplitude and cost of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koop_identify.model.windows import cut_windows, settled_windows
from koop_identify.recording.signals import Signals
from koop_loop.oscillation import amplitude
from koopman_lifter.config import LifterConfig


@dataclass(frozen=True)
class Windows:
    """Settled windows, K in all.

    Attributes
    ----------
    length : float
        Of a window [s].
    t : ndarray, shape (K,)
        Begin of each [s].
    theta : ndarray, shape (K,), or None
        Mean theta of each; None if it was not recorded.
    r : ndarray, shape (K,)
        Mean cost of each; NaN where there is none.
    amplitude : ndarray, shape (n, K)
        Of each channel.
    """

    length: float
    t: NDArray[np.float64]
    theta: NDArray[np.float64] | None
    r: NDArray[np.float64]
    amplitude: NDArray[np.float64]


def windows_of(signals: Signals, r: NDArray[np.float64], lifter: LifterConfig) -> Windows:
    """Cut a recording into settled windows.

    Parameters
    ----------
    signals : Signals
        The recording.
    r : ndarray, shape (M,)
        Cost of each state; NaN where there is none.
    lifter : LifterConfig
        Its filters say how long to wait after a jump of theta.
    """
    settling, dt = lifter.detector_params().settling, signals.dt
    theta = signals.theta if signals.has_theta else None
    starts, length = settled_windows(theta, signals.begins, dt, settling * dt)
    if not starts.size:
        empty = np.empty(0)
        channels = np.empty((signals.x.shape[1], 0))
        return Windows(0.0, empty, None if theta is None else empty, empty, channels)
    in_windows = cut_windows(r, starts, length)
    usable = np.isfinite(in_windows).any(axis=1)
    mean = np.full(starts.size, np.nan)
    mean[usable] = np.nanmean(in_windows[usable], axis=1)
    return Windows(
        length * dt,
        signals.t[starts],
        None if theta is None else cut_windows(theta, starts, length).mean(axis=1),
        mean,
        amplitude(cut_windows(signals.x.T, starts, length)),
    )
