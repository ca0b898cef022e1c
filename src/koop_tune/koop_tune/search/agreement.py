"""A measured closed loop, compared with its prediction.

The amplitude is that of the channel or band in which theta shows most, in the windows of the
excitation; converged, distance and excess are those of :mod:`koop_tune.search.run`. The
prediction's band is widened by what the measured amplitudes do not know: two standard errors.
Better than predicted agrees.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import ConfigError
from koop_tune.excitation.features import Bands, log_amplitudes
from koop_tune.excitation.visits import standard_error
from koop_tune.rig.rig_file import RigFile
from koop_tune.rig.scale import Scale
from koop_tune.rig_model.surrogate import BLOCKS
from koop_tune.search.prediction import Prediction
from koop_tune.search.settings import CONVERGENCE, VERIFICATION, VerificationSettings


@dataclass(frozen=True)
class Aim:
    """What a tuning expects of a rig.

    Attributes
    ----------
    bands : Bands
        How windows are looked at.
    feature : int
        The amplitude that counts.
    name : str
        Its name.
    scale : Scale
        Theta's range.
    sense : float
        +1 if little is wanted, else -1.
    theta : float
        The best theta.
    best, bound : float
        Logarithms of the best amplitude, and of that at which a loop counts as converged.
    time : float
        The rig's own time [s].
    predicted : Prediction
        The tuning's.
    settings : VerificationSettings
        How a loop is compared with it.
    """

    bands: Bands
    feature: int
    name: str
    scale: Scale
    sense: float
    theta: float
    best: float
    bound: float
    time: float
    predicted: Prediction
    settings: VerificationSettings = VERIFICATION

    @property
    def window(self) -> float:
        """Length of a window [s]."""
        return self.bands.length * self.bands.dt

    @property
    def longest(self) -> float:
        """Duration of the predicted runs [s]; the figures describe their second half."""
        return self.predicted.duration

    @property
    def duration(self) -> float:
        """Shortest duration of a closed loop that can confirm the prediction [s]."""
        whole, late = self.longest, self.predicted.converges.high
        return min(max(self.settings.twice * late, self.settings.least * whole), whole)

    def amplitudes(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the logarithm of the amplitude in each whole window of samples, shape (M, n)."""
        length = self.bands.length
        starts = range(0, x.shape[0] - length + 1, length)
        return np.array(
            [log_amplitudes(x[k : k + length], self.bands)[self.feature] for k in starts]
        )


def make_aim(figures: dict[str, Any], rig: RigFile) -> Aim:
    """Return the aim in the content of a tune.json.

    Raises
    ------
    KeyError
        If it is not that of a controller.
    """
    windows = figures["windows"]
    sense = rig.sense
    levels = sense * np.log(figures["static_map"]["amplitude"])
    best, worst = float(levels.min()), float(levels.max())
    bound = best + CONVERGENCE.bound(worst - best)
    return Aim(
        Bands(windows["length"], tuple(windows["edges"]), windows["dt"]),
        windows["feature"], figures["feature"], rig.scale, sense,
        figures["theta_best"], sense * best, sense * bound, figures["time"],
        Prediction.from_json(figures["predicted"]),
    )  # fmt: skip


def read_aim(path: Path, rig: RigFile) -> Aim:
    """Read a tune.json.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If there is none, or it holds no controller.
    """
    try:
        return make_aim(json.loads(path.read_text(encoding="utf-8")), rig)
    except FileNotFoundError:
        raise ConfigError(f"{path} is not there: koop tune first") from None
    except (OSError, ValueError, KeyError, TypeError):
        raise ConfigError(f"{path}: holds no controller: koop tune first") from None


@dataclass(frozen=True)
class Measured:
    """Measured figures of one closed loop.

    Attributes
    ----------
    time_to_converge : float or None
        [s]; None if never.
    distance : float
        Mean of abs(u - u*) over the second half, in ranges of theta.
    amplitude_before, amplitude : float
        Before the loop was closed, and over the second half.
    error : float
        Standard error of the logarithm of their ratio.
    excess : float
        Amplitude over the best one (its inverse where it is to be large).
    reduction : float
        Amplitude before over that of the second half (its inverse).
    theta, swing : float
        Mean and range of theta over the second half.
    """

    time_to_converge: float | None
    distance: float
    amplitude_before: float
    amplitude: float
    error: float
    excess: float
    reduction: float
    theta: float
    swing: float

    @property
    def damped(self) -> bool:
        """Whether the amplitude ended near the best one."""
        return self.excess <= CONVERGENCE.good


def measure(
    aim: Aim, before: NDArray[np.float64], x: NDArray[np.float64], theta: NDArray[np.float64]
) -> Measured:
    """Measure a run.

    Parameters
    ----------
    aim : Aim
        What it should come to.
    before : ndarray, shape (B, n)
        Measured channels once the rig had settled where the loop began.
    x : ndarray, shape (M, n)
        Measured channels with the loop closed.
    theta : ndarray, shape (K,)
        Its theta, evenly over the same time.
    """
    logs, first = aim.amplitudes(x), aim.amplitudes(before)
    late, end = logs[logs.size // 2 :], theta[theta.size // 2 :]
    amplitude, began = _root_mean_square(late), _root_mean_square(first)
    k = min(max(aim.settings.smoothed, math.ceil(logs.size / BLOCKS)), logs.size)
    smooth = [_root_mean_square(logs[i : i + k]) for i in range(logs.size - k + 1)]
    inside = np.flatnonzero(aim.sense * (np.array(smooth) - aim.bound) <= 0.0)
    errors = [float(standard_error(part[:, None])[0]) for part in (late, first)]
    u = aim.scale.u(end)
    return Measured(
        (int(inside[0]) + k) * aim.window if inside.size else None,
        float(np.abs(u - aim.scale.u(np.array(aim.theta))).mean()),
        math.exp(began),
        math.exp(amplitude),
        math.hypot(*(error if math.isfinite(error) else 0.0 for error in errors)),
        math.exp(aim.sense * (amplitude - aim.best)),
        math.exp(aim.sense * (began - amplitude)),
        aim.scale.theta_at(float(u.mean())),
        float(np.ptp(end)),
    )


def _root_mean_square(logs: NDArray[np.float64]) -> float:
    return 0.5 * math.log(float(np.exp(2.0 * logs).mean()))


def find_disagreements(aim: Aim, run: Measured) -> list[str]:
    """Return the figures that are worse than predicted, in words.

    A prediction that allows almost anything is not confirmed by anything.
    """
    return _lasting(aim, run) + _passing(aim, run)


def may_yet_agree(aim: Aim, run: Measured) -> bool:
    """Return whether a longer run of the same loop may still agree.

    An adaptive law arrives with a large step and takes its time to make it small.
    """
    short = bool(_passing(aim, run)) or not run.damped
    return short and not _lasting(aim, run)


def _lasting(aim: Aim, run: Measured) -> list[str]:
    p, worse = aim.predicted, []
    if p.excess.high > aim.settings.blurred:
        worse.append(
            f"the prediction, {p.excess.low:.3g} to {p.excess.high:.3g} times the best "
            "amplitude, is too wide to be confirmed"
        )
    late, took = p.converges.high, run.time_to_converge
    limit = aim.settings.later * late + aim.settings.smoothed * aim.window
    if (math.inf if took is None else took) > limit:
        outcome = "did not converge" if took is None else f"took {took:.4g} s to converge"
        worse.append(f"{outcome}, at most {late:.4g} s were predicted")
    return worse


def _passing(aim: Aim, run: Measured) -> list[str]:
    p, widened, worse = aim.predicted, math.exp(aim.settings.errors * run.error), []
    if run.excess > p.excess.high * widened:
        worse.append(
            f"ended at {run.excess:.3g} times the best amplitude, at most "
            f"{p.excess.high:.3g} were predicted"
        )
    if run.reduction < p.reduction.low / widened:
        worse.append(
            f"changed the amplitude by a factor of {run.reduction:.3g}, at least "
            f"{p.reduction.low:.3g} was predicted"
        )
    return worse


def verdict(aim: Aim, runs: Sequence[Measured], rounds: int, where: str) -> str:
    """Return the verdict of a verification in three sentences.

    Parameters
    ----------
    aim : Aim
        What was predicted.
    runs : sequence of Measured
        Runs of the last round.
    rounds : int
        How many there were.
    where : str
        Folder that ``koop up`` runs.
    """
    worse = [text for run in runs for text in find_disagreements(aim, run)]
    damped = all(run.damped for run in runs)
    fell = "falls" if aim.sense > 0 else "rises"
    first = (
        f"From {_each(len(runs), 'start')} theta ends at {_list(run.theta for run in runs)}, and "
        f"the amplitude of {aim.name} {fell} by a factor of "
        f"{_list(run.reduction for run in runs)} to {_list(run.excess for run in runs)} times the "
        "best of the static map"
    )
    took = _list(run.time_to_converge for run in runs)
    second = f"It converged after {took} s; {aim.predicted.converges.as_text()} s were predicted"
    if damped and not worse:
        third = f"The rig is damped as predicted: ./koop up {where} runs it"
    elif damped:
        third = (
            f"The rig is damped, but after {_each(rounds, 'round')} not as predicted: {worse[0]}"
        )
    else:
        third = (
            f"The rig is not damped after {_each(rounds, 'round')}: "
            f"{worse[0] if worse else 'the static map is not known well enough'}; record it again "
            "with longer rests (increase 'time')"
        )
    return f"{first}. {second}. {third}."


def _each(count: int, what: str) -> str:
    """Return a count with its noun.

    >>> _each(2, "start")
    '2 starts'
    """
    return f"{count} {what}{'s' if count != 1 else ''}"


def _list(values: Any) -> str:
    return " and ".join("never" if value is None else f"{value:.3g}" for value in values)
