"""A cost that has risen for good, on costs whose level is known."""

import numpy as np
import pytest

from relay_esc.config import EscConfig
from relay_esc.level import LEVEL, CostLevel

DWELL = 50  # samples
WINDOW = round(LEVEL.window * DWELL)


def findings(levels, minimise=True, noise=0.0):
    """Return what is found after each window of a mean cost, which the loop's swing moves."""
    rng, watch, found = np.random.default_rng(0), CostLevel(DWELL, minimise), []
    swing = 1.0 + 0.5 * np.sin(2.0 * np.pi * np.arange(WINDOW) / (4 * DWELL))
    for level in levels:
        for r in level * swing * np.exp(noise * rng.standard_normal(WINDOW)):
            watch.take(float(r))
        found.append(watch.finding())
    return found


def test_a_cost_that_stays_where_it_was_brought_to_is_no_finding():
    assert findings([9.0, 2.0, 1.0, 1.1, 1.4, 1.9], noise=0.5) == [""] * 6


def test_a_cost_that_rises_above_the_best_of_the_run_is_found_until_it_falls():
    *calm, risen, fallen = findings([9.0, 1.0, 5.0, 1.0])
    assert calm == ["", ""]
    assert risen.startswith("the cost is 5 times the least of this run: the optimum may have moved")
    assert fallen == ""


def test_a_cost_that_is_to_be_large_is_found_where_it_falls():
    *calm, fallen = findings([1.0, 8.0, 1.0], minimise=False)
    assert calm == ["", ""]
    assert fallen.startswith("the largest cost of this run was 8 times what it is now")


@pytest.mark.parametrize("off", [0.0, 1e-12, 1e-4])
@pytest.mark.parametrize(("before", "at"), [(0, 0.0), (0, 0.3), (4, 0.0), (4, 0.7)])
def test_a_rig_that_is_off_leaves_no_least_that_it_never_reaches_again(before, at, off):
    """Failed before: after an hour in which the rig was off, its cost had risen for ever."""
    watch, found = CostLevel(DWELL, minimise=True), []
    off_from, on_from = round((before + at) * WINDOW), round((before + at + 2.2) * WINDOW)
    for k in range(12 * WINDOW):
        r = off if off_from <= k < on_from else (1.0 if k < 10 * WINDOW else 5.0)
        watch.take(r * (1.2 if k % DWELL else 0.8))
        found.append(watch.finding())
    assert set(found[: 10 * WINDOW]) == {""}
    assert "the cost is 5 times the least of this run" in found[-1]


@pytest.mark.parametrize("levels", [[0.0, 0.0], [1.0, 0.0]])
def test_a_cost_of_zero_is_no_finding(levels):
    assert findings(levels) == ["", ""]


def test_a_loop_without_a_dwell_time_has_windows_too():
    watch = CostLevel(EscConfig(dwell=0.0).params(0.01).dwell_samples, True)
    for r in [1.0] * LEVEL.least + [4.0] * LEVEL.least:
        watch.take(r)
    assert watch.rise == pytest.approx(4.0)
