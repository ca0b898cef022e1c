"""Rigs that a recording may be of: segments, blocks and draws."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from surrogate_rigs import DT, make_cost, make_dwells, make_findings, make_map

from koop_identify.recording.loaded import Loaded
from koop_tune.excitation.safe_range import SafeRange
from koop_tune.rig.rig_file import RigFile
from koop_tune.rig_model.dwells import Rest
from koop_tune.rig_model.surrogate import Times
from koop_tune.search.settings import TuningSettings
from koop_tune.search.task import block_rms, cut_segments, draw_surrogates, make_task

RIG = RigFile("/a:x", "/b:z", DT, 0.0, 1.0, 0.5, 0.5, 0.5)
TIMES = Times(math.log(2.0), 0.0, 0.0, 0.0)


def valley(u):
    return 4.0 * (u - 0.5) ** 2


def test_pieces_are_the_settled_part_of_each_rest_by_theta_without_their_mean():
    values = np.arange(400.0)
    values[250] = math.nan
    rests = [Rest(1, 0, 100, 2), Rest(0, 200, 300, 0), Rest(1, 300, 400, 1)]
    dwells = make_dwells(rests, [], 20, count=3)
    parts, first = cut_segments(values, dwells)
    assert [part.size for part in parts] == [99, 60, 80]  # without the one that is unusable
    assert first.tolist() == [0, 1, 3, 3]  # the last value has none
    for part, begin in zip(parts, (200, 40, 320), strict=True):
        assert part.mean() == pytest.approx(0.0, abs=1e-9)
        assert np.diff(part)[0] == 1.0
        assert part[0] == pytest.approx(
            begin - np.nanmean(values[begin : begin + 100][: part.size]), abs=1.0
        )


def test_blocks_keep_the_power_of_a_signal():
    y = np.random.default_rng(0).normal(size=1003)
    blocks = block_rms(y, 10)
    assert blocks.size == 100
    assert (blocks**2).mean() == pytest.approx((y[:1000] ** 2).mean())
    assert block_rms(y[:3], 10).size == 1


def test_the_first_rig_is_as_it_was_measured_and_the_others_differ_as_its_errors_say():
    findings = make_findings(valley, error=0.2)
    recorded = np.zeros(18), np.arange(10) * 2, np.arange(10)
    settings = TuningSettings(surrogates=200, seed=1)
    given = findings, make_map(valley, 0.2), recorded, TIMES, settings, DT
    drawn = draw_surrogates(*given)
    first, *others = drawn
    assert len(drawn) == 200
    assert first.times == TIMES
    assert first.levels == pytest.approx(make_map(valley, 0.2).curve, abs=0.01)
    shifts = [s.times.usual - TIMES.usual for s in others]
    assert np.std(shifts) == pytest.approx(settings.tau_spread, rel=0.15)
    assert abs(np.mean(shifts)) < 0.1
    ends = [s.levels[0] - first.levels[0] for s in others]
    assert 0.05 < np.std(ends) < 0.4  # smoothed between points that scatter by 0.2
    again = draw_surrogates(*given)
    assert [s.times.usual for s in again] == [s.times.usual for s in drawn]


def test_a_task_holds_every_usable_corner_frequency_sample_by_sample_and_in_blocks():
    length, per = 50, 40
    theta = np.repeat(np.linspace(0.0, 1.0, 9), length * per)
    noise = np.random.default_rng(0).normal(size=theta.size)
    y = 2.0 + lfilter([1.0], [1.0, -0.5], noise)
    loaded = Loaded(y[None], np.arange(y.size) == 0, theta, y)
    rests = [Rest(i, i * length * per, (i + 1) * length * per, 2) for i in range(9)]
    dwells = make_dwells(rests, [np.zeros(per)] * 9, length)
    cost = make_cost("raw", valley)
    maps = {4.0: make_map(valley), 9.0: make_map(lambda u: u)}
    cost = replace(cost, cost=cost.cost._replace(y_out=y), maps=maps)
    findings = replace(make_findings(valley, [cost]), dwells=dwells)
    settings = TuningSettings(blocks=10)
    task = make_task(loaded, findings, cost, TIMES, 5.0, RIG, settings)
    assert list(task.surrogates) == list(task.coarse) == [4.0]  # the other has no optimum inside
    assert len(task.surrogates[4.0]) == settings.surrogates
    coarse = task.coarse[4.0][0]
    assert coarse.coarse
    assert coarse.dt == pytest.approx(25 * DT)  # 5 s in ten blocks
    alpha = math.exp(-4.0 * DT)
    high = (1.0 - alpha) * lfilter([1.0, -1.0], [1.0, -alpha], y - y[0])
    power = np.mean([high[r.begin + 2 * length : r.end].var() for r in rests])
    assert (coarse.y**2).mean() == pytest.approx(power, rel=0.02)
    assert (task.low, task.high, task.rate) == (0.0, 1.0, 0.5)
    assert (task.slope, task.edge) == (0.0, 0.0)
    safe = SafeRange((0.0, 0.5, 0.8), (0.6, 0.4, 0.1), 0.0, 0.8, False, True)
    task = make_task(loaded, replace(findings, safe=safe), cost, TIMES, 5.0, RIG, settings)
    assert (task.slope, task.edge) == pytest.approx((-1.0, 0.9))
