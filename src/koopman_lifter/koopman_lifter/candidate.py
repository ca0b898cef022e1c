"""A model of the rig as it is after a change, and whether it is better than the one in use.

From the change on samples are kept, as many as ``CANDIDATE.periods`` have: identification from them
is the one from a recording, to the bit, a sample costs a copy, and nothing is updated that could
wind up where the loop does not excite. They are cut into windows. From the first half of these the
candidate is learned, its cost the contrast (:mod:`koopman_lifter.contrast`) between windows whose
amplitude at the oscillation's frequency is large and small. Where interference has drowned the
oscillation, theta does not seek, and there is no order of windows to learn: then the candidate's
cost is the direction with the most of its power at that frequency, if that cleans the cost
(:class:`Shares`).

On the other half, which it has not seen, it is judged against the model in use: by how well the
cost orders the windows by that amplitude, which no model has a part in. With Spearman's rank
correlations rho of n windows, atanh rho has the variance 1.06 / (n - 3) (Fieller, Hartley and
Pearson 1957), and the candidate is better if

    (atanh rho' - atanh rho) / sqrt(2.12 / (n - 3)) > CANDIDATE.better

or it cleans the cost, and its one-step error is not larger. Its projector is scaled so that the
mean energy stays as it was, and with it what was tuned for the model in use.

A candidate that is used at once is on trial: for as many periods again the oscillation is compared
with what it was before (:func:`growth`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.errors import InputError
from koop_core.kernels import njit
from koopman_lifter.contrast import (
    can_split,
    in_band,
    moments,
    spectra,
    with_band,
    with_contrast,
)
from koopman_lifter.delays import units
from koopman_lifter.edmd import Gram
from koopman_lifter.model import KoopmanModel, build
from koopman_lifter.settings import CANDIDATE, COST

TINY = float(np.finfo(float).tiny)
SPARE = 1.25  # samples over those of the fewest windows: a gap takes one or two
LARGEST = 2**22  # samples: 100 MB of two channels


class Samples(NamedTuple):
    """Measured states that are kept until they are enough."""

    states: NDArray[np.float64]
    """Shape (M, channels)."""
    steps: NDArray[np.int64]
    """Shape (M,)."""
    cursor: NDArray[np.int64]
    """Shape (1,): how many there are."""

    @property
    def full(self) -> bool:
        """Whether they are enough; also where none are to be kept."""
        return int(self.cursor[0]) == self.steps.size


def room(channels: int, size: int = 0) -> Samples:
    """Return room for so many samples."""
    return Samples(np.empty((size, channels)), np.empty(size, np.int64), np.zeros(1, np.int64))


def size_of(frequency: float, dt: float) -> int:
    """Return how many samples are enough for an oscillation of a frequency [Hz]."""
    least = round(SPARE * 2 * CANDIDATE.fewest * CANDIDATE.window / (frequency * dt))
    return min(round(CANDIDATE.periods / (frequency * dt)), max(CANDIDATE.most, least), LARGEST)


@njit()
def keep(samples: Samples, step: int, x: NDArray[np.float64]) -> None:
    """Keep a measured state, shape (channels,), if there is room and it is finite."""
    i = samples.cursor[0]
    if i == samples.steps.shape[0]:
        return
    for j in range(x.shape[0]):
        if not math.isfinite(x[j]):
            return
        samples.states[i, j] = x[j]
    samples.steps[i] = step
    samples.cursor[0] = i + 1


class Shares(NamedTuple):
    """Share of the power of what a cost is made of that lies at the oscillation's frequency.

    See :func:`share`: under the model in use, and under the candidate.
    """

    in_use: float
    candidate: float

    @property
    def clean(self) -> bool:
        """Whether the candidate shows an oscillation that has drowned under the model in use."""
        use, candidate = self
        purer = candidate * (1.0 - use) > CANDIDATE.purer * use * (1.0 - candidate)
        return purer and use < CANDIDATE.drowned <= candidate


@dataclass(frozen=True)
class Judgement:
    """The model in use and the candidate on windows that neither was learned from."""

    windows: int
    """How many."""
    ranks: tuple[float, float]
    """Rank correlation of the cost with the amplitude: of the model in use, of the candidate."""
    errors: tuple[float, float]
    """One-step error over the observables' root mean square, of the same."""
    shares: Shares
    """Of the same."""

    @property
    def better(self) -> bool:
        """Whether the candidate is better."""
        z, z_candidate = (math.atanh(min(max(rho, -0.999), 0.999)) for rho in self.ranks)
        evidence = (z_candidate - z) / math.sqrt(2.12 / (self.windows - 3))
        shows = self.shares.clean or evidence > CANDIDATE.better
        return shows and self.errors[1] <= self.errors[0]

    def __str__(self) -> str:
        (rank, candidate), (error, after) = self.ranks, self.errors
        if self.shares.clean:
            use, shown = (100.0 * share for share in self.shares)
            return (
                f"on {self.windows} windows since the change {shown:.3g} % of the cost's power is "
                f"the oscillation's under a new model, {use:.3g} % under the one in use; one-step "
                f"errors are {after:.2g} and {error:.2g}"
            )
        return (
            f"on {self.windows} windows since the change the cost follows the amplitude with a "
            f"rank correlation of {candidate:.2f} under a new model, {rank:.2f} under the one in "
            f"use; one-step errors are {after:.2g} and {error:.2g}"
        )


def learn_candidate(
    model: KoopmanModel, samples: Samples, frequency: float, omega_h: float
) -> tuple[KoopmanModel, Judgement]:
    """Learn a candidate for the model in use from samples since the change, and judge it.

    ``frequency`` is the oscillation's [Hz], ``omega_h`` of the detector's high-pass filter [rad/s].
    Raises InputError if the samples cannot determine a model or judge it.
    """
    from scipy.stats import spearmanr  # slow to import, and the lifter has no use for it

    length = round(CANDIDATE.window / (frequency * model.dt))
    windows = cut(samples, max(length, 2 * model.delays.depth))
    half = len(windows) // 2
    amplitude = amplitudes(windows, frequency * model.dt)
    learned, judged = windows[:half], windows[half:]
    if half < CANDIDATE.fewest:
        raise InputError(f"{len(windows)} windows since the change are too few to learn from")
    gram = _sum_up(model, learned)
    provenance = {
        "source": "operation",
        "in_place_of": model.model_id,
        "variant": "contrast",
        "windows": half,
        "window": float(f"{windows.shape[2] * model.dt:.4g}"),
        "strong_and_weak_by": f"amplitude at {frequency:.4g} Hz",
    }
    count = int(model.kept.sum())
    candidate = build(gram, model.dt, model.state_names, count, provenance, model.delays)
    cleaner = with_band(candidate, learned, frequency * model.dt)
    if shares_of(model, cleaner, learned, frequency * model.dt).clean:
        candidate = cleaner
    elif can_split(amplitude[:half]):
        joined = np.hstack(list(learned))
        starts = windows.shape[2] * np.arange(half)
        spread = moments(joined, starts, windows.shape[2], model.delays)
        candidate = with_contrast(candidate, *spread, amplitude[:half])
    else:
        raise InputError("the oscillation was the same in all windows since the change")
    costs = [energies(each, judged, omega_h) for each in (model, candidate)]
    mean, new_mean = (float(each.means.mean()) for each in costs)
    if new_mean > 0.0:
        scaled = candidate.projector * math.sqrt(mean / new_mean)
        candidate = replace(candidate, projector=scaled)
    seen = _sum_up(model, judged)
    use, new = (float(spearmanr(amplitude[half:], each.amplitudes).statistic) for each in costs)
    errors = one_step_error(model, seen), one_step_error(candidate, seen)
    shares = shares_of(model, candidate, judged, frequency * model.dt)
    return candidate, Judgement(len(judged), (use, new), errors, shares)


def cut(samples: Samples, length: int) -> NDArray[np.float64]:
    """Return consecutive samples as windows, shape (T, channels, length); none spans a gap.

    One or two lost samples are interpolated, as the cost does it.
    """
    count = int(samples.cursor[0])
    steps, states = samples.steps[:count], samples.states[:count]
    lost = np.diff(steps) - 1
    ends = np.flatnonzero((lost < 0) | (lost > COST.bridged)) + 1
    whole = [
        _bridge(*piece, length)
        for piece in zip(np.split(steps, ends), np.split(states, ends), strict=True)
    ]
    return np.ascontiguousarray(
        np.concatenate(whole).reshape(-1, length, states.shape[1]).swapaxes(1, 2)
    )


def _bridge(
    steps: NDArray[np.int64], states: NDArray[np.float64], length: int
) -> NDArray[np.float64]:
    """Return the states of all steps from the first on, those of whole windows."""
    known = steps - steps[:1]
    count = (int(known.max(initial=-1)) + 1) // length * length
    if not count:
        return states[:0]
    return np.stack([np.interp(np.arange(count), known, column) for column in states.T], axis=1)


def amplitudes(windows: NDArray[np.float64], frequency: float) -> NDArray[np.float64]:
    """Return the amplitude of each window at a frequency, in cycles a sample, shape (T,).

    Channels count in units of their standard deviation; interference three bins away is out.
    """
    length = windows.shape[2]
    taper = np.blackman(length) * np.exp(-2j * math.pi * frequency * np.arange(length))
    centred = windows - windows.mean(axis=2, keepdims=True)
    lines = np.abs(centred @ taper) / units(windows, (0, 2))
    return np.asarray(np.sqrt((lines**2).sum(axis=1)))


def growth(before: Samples, after: Samples, frequency: float) -> tuple[float, bool]:
    """Return by which factor an oscillation has grown, and whether it has grown for sure.

    Of either samples the later half counts, in which a controller has had time to settle;
    ``frequency`` is in cycles a sample. Sure are ``CANDIDATE.better`` standard errors of the mean
    ln amplitude, and a factor of ``CANDIDATE.worse``. Raises InputError if gaps leave few windows.
    """
    windows = [cut(samples, round(CANDIDATE.window / frequency)) for samples in (before, after)]
    if (count := min(map(len, windows))) < CANDIDATE.fewest:
        raise InputError(f"{count} windows without a gap are too few to judge the oscillation by")
    levels = np.log(np.maximum(amplitudes(np.concatenate(windows), frequency), TINY))
    parts = [part[len(part) // 2 :] for part in np.split(levels, [len(windows[0])])]
    rise = float(parts[1].mean() - parts[0].mean())
    error = math.sqrt(sum(part.var(ddof=1) / len(part) for part in parts))
    return math.exp(rise), rise > max(CANDIDATE.better * error, math.log(CANDIDATE.worse))


class Energies(NamedTuple):
    """Mean of y_out over each window, and the amplitude that the detector has of it."""

    means: NDArray[np.float64]
    amplitudes: NDArray[np.float64]


def energies(model: KoopmanModel, windows: NDArray[np.float64], omega_h: float) -> Energies:
    """Return y_out under a model, through the detector's high-pass filter, shape (T,) each."""
    lifted = (model.observables.lift(model.delays.embed(window)) for window in windows)
    y_out = np.array([((model.projector @ z) ** 2).sum(axis=0) for z in lifted])
    spectrum = np.fft.rfft((y_out - y_out.mean(axis=1, keepdims=True)) * np.hanning(y_out.shape[1]))
    delay = np.exp(-2j * math.pi * np.fft.rfftfreq(y_out.shape[1]))
    alpha = math.exp(-omega_h * model.dt)
    passed = np.abs((1.0 - alpha) * (1.0 - delay) / (1.0 - alpha * delay) * spectrum)
    return Energies(y_out.mean(axis=1), (passed**2).sum(axis=1))


def share(model: KoopmanModel, windows: NDArray[np.float64], frequency: float) -> float:
    """Return the share of the power of what the cost is made of that lies in a band.

    Of an oscillation, see :func:`koopman_lifter.contrast.in_band`.
    """
    lifted = (model.observables.lift(model.delays.embed(window)) for window in windows)
    coordinates = np.stack([model.projector @ z for z in lifted])
    power = (np.abs(spectra(coordinates)) ** 2).sum(axis=(0, 1))
    return float(power[in_band(coordinates.shape[2], frequency)].sum() / max(power.sum(), TINY))


def shares_of(
    model: KoopmanModel, candidate: KoopmanModel, windows: NDArray[np.float64], frequency: float
) -> Shares:
    """Return :func:`share` of the model in use and of the candidate."""
    return Shares(share(model, windows, frequency), share(candidate, windows, frequency))


def one_step_error(model: KoopmanModel, gram: Gram) -> float:
    """Return the root mean square of g(x_{k+1}) - K g(x_k), each over that of g_i(x)."""
    k = model.K * gram.scale[None, :] / gram.scale[:, None]
    now, cross, after = (gram.equilibrated(sums) for sums in (gram.xx, gram.yx, gram.yy))
    squares = np.trace(after) - 2.0 * np.trace(k @ cross.T) + np.trace(k @ now @ k.T)
    return math.sqrt(max(squares / len(k), 0.0))


def _sum_up(model: KoopmanModel, windows: NDArray[np.float64]) -> Gram:
    gram = Gram.empty(model.observables)
    for window in windows:
        gram.add_trajectory(model.delays.embed(window))
    return gram
