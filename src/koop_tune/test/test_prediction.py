"""Predictions: bands, and how much an amplitude differs by itself."""

import math

import numpy as np
import pytest
from scipy.signal import lfilter
from surrogate_rigs import make_dwells, make_findings, make_task

from koop_tune.excitation.static_map import GRID
from koop_tune.rig_model.dwells import Rest
from koop_tune.search.prediction import Band, find_wander, predict
from koop_tune.search.search import Trial, search


def test_a_band_holds_nine_of_ten_values_and_never_is_infinite():
    values = [*map(float, range(1, 100)), math.inf]
    band = Band.of(values)
    assert (band.low, band.middle, band.high) == pytest.approx((6.0, 50.0, 95.0), abs=1.0)
    assert Band.of([1.0] * 16 + [math.inf] * 4).high == math.inf
    assert Band.of([1.0, 2.0, math.inf]).as_text() == "2 (1 to never)"


def noise_driven(tau, rest, count, rng, length=50, dt=0.02):
    """Return rests of an oscillation whose amplitude is an Ornstein-Uhlenbeck process."""
    keep = math.exp(-length * dt / tau)
    amplitude = []
    for _ in range(count):
        white = rng.normal(size=(2, rest + 200)) * math.sqrt(1.0 - keep**2)
        z = lfilter([1.0], [1.0, -keep], white, axis=1)[:, 200:]
        amplitude.append(0.5 * np.log((z**2).sum(axis=0)))
    rests = [Rest(i % 9, i * rest * length, (i + 1) * rest * length, 0) for i in range(count)]
    return make_dwells(rests, amplitude, length, dt)


def test_how_much_an_amplitude_differs_by_itself_is_the_spread_over_that_time():
    rng, tau, rest = np.random.default_rng(0), 6.0, 400
    dwells = noise_driven(tau, rest, 18, rng)
    levels = [0.5 * math.log(np.exp(2.0 * a).mean())
              for a in noise_driven(tau, rest, 600, rng).logs]  # fmt: skip
    samples = rest * dwells.length
    assert find_wander(dwells, samples) == pytest.approx(np.std(levels), rel=0.35)
    assert find_wander(dwells, 4 * samples) == pytest.approx(0.5 * find_wander(dwells, samples))


def test_the_error_of_the_best_amplitude_widens_the_bands():
    def level(u):
        return 3.0 * np.abs(u - 0.6)

    task = make_task(level)
    best = search(task, 0.125, 0)[0]

    def excess(error, wander):
        """Return the width of the band, and the deviation of the map at its best."""
        observed = make_findings(level, error=error, wander=wander)
        prediction, runs = predict(task, Trial(best.constants, [], 0.0, 90.0), observed, 1, 16)
        assert (len(runs), prediction.runs) == (16, 16)
        assert prediction.duration == task.steps * task.dt
        assert prediction.converges.high == max(run.converged for run in runs)
        width = math.log(prediction.excess.high / prediction.excess.low)
        at = round(observed.static_map.best() * (GRID - 1))
        return width, float(observed.static_map.deviation[at])

    width, deviation = excess(0.5, 1e-6)
    assert deviation > 0.1
    assert width == pytest.approx(2.0 * 1.645 * deviation, rel=0.6)
    assert excess(1e-6, 1e-6)[0] < 0.8 * width
