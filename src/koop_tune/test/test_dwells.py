"""Where theta was held in a recording, and the amplitudes and spectra there."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from surrogate_rigs import make_dwells

from koop_core.errors import InputError
from koop_identify.recording.loaded import Loaded
from koop_tune.excitation.amplitude import Windows, choose_amplitude
from koop_tune.rig.scale import Scale
from koop_tune.rig_model.dwells import (
    Rest,
    find_dwells,
    find_holds,
    find_rests,
)
from koop_tune.rig_model.spectra import spectra_by_theta

DT = 0.02
UNIT = Scale(0.0, 1.0)


def recording(theta, x=None, begins=(0,)):
    x = np.zeros((theta.size, 1)) if x is None else np.asarray(x)
    starts = np.isin(np.arange(theta.size), begins)
    return Loaded(
        np.ascontiguousarray(x.T), starts, theta,
        np.arange(theta.size) * DT,
    )  # fmt: skip


def staircase(values, rest, repeats=1):
    return np.repeat(np.tile(values, repeats), rest)


def test_a_theta_that_moves_slowly_does_not_rest_on_its_way():
    values = np.linspace(0.0, 1.0, 9)
    way = [np.linspace(a, b, 2001)[1:] for a, b in pairwise(values)]
    theta = np.concatenate([part for v, w in zip(values, [*way, []], strict=True)
                            for part in (np.full(1000, v), w)])  # fmt: skip
    u, rests = find_rests(recording(theta), UNIT, 16)
    assert u == pytest.approx(values)
    assert [(rest.end - rest.begin) // 16 for rest in rests] == [62] * 9
    assert [rest.level for rest in rests] == list(range(9))


def test_rests_of_a_loop_do_not_join_the_values_of_the_excitation():
    values = [*np.linspace(0.0, 1.0, 9), *np.arange(0.0, 1.0, 0.015)]
    u, _ = find_rests(recording(np.repeat(values, 100)), UNIT, 16)
    assert u.size > 9
    assert np.diff(u).max() < 0.05


def test_a_rest_ends_where_states_are_missing_or_theta_is_unknown():
    theta = staircase(np.linspace(0.0, 1.0, 5), 320)
    _, rests = find_rests(recording(theta, begins=(0, 560)), UNIT, 16)
    assert [(rest.begin, rest.end) for rest in rests[1:3]] == [(320, 560), (560, 640)]
    theta[:160] = np.nan
    _, rests = find_rests(recording(theta), UNIT, 16)
    assert rests[0].begin == 160


def test_of_a_rest_that_was_cut_the_part_in_which_the_rig_may_not_have_settled_does_not_count():
    theta = staircase(np.linspace(0.0, 1.0, 6), 320)
    theta[400:410] = theta[700:720] = np.nan  # not known yet, and for a moment
    cut = (400, 470, 550, 1020, 1720, 1760, 1800, 1840, 1880)
    _, rests = find_rests(recording(theta, begins=(0, *cut)), UNIT, 16)
    pieces = [(0, 320), (550, 630), (720, 960), (1020, 1276), (1280, 1600)]
    assert [(rest.begin, rest.end) for rest in rests] == pieces


@pytest.mark.parametrize(
    ("theta", "message"),
    [
        (np.full(2000, np.nan), "no theta"),
        (staircase([0.0, 0.3, 0.6, 1.0], 320), "at 4 values"),
        (staircase(np.linspace(0.0, 1.0, 9), 48), "at 0 values"),  # three windows each
    ],
)
def test_a_recording_with_too_few_rests_is_refused(theta, message):
    with pytest.raises(InputError, match=message):
        find_rests(recording(theta), UNIT, 16)


def oscillating(theta, frequency, amplitude, seed=0):
    t = np.arange(theta.size) * DT
    noise = np.random.default_rng(seed).normal(0.0, 0.3, t.size)
    return amplitude(theta) * np.sin(2.0 * np.pi * frequency * t) + noise


def test_a_rest_that_lost_messages_cut_short_is_left_out_of_the_spectra():
    theta = np.repeat([0.0, 1.0, 2.0, 3.0, 4.0, 1.5], [1600] * 5 + [64])
    x = oscillating(theta, 1.0, lambda theta: 1.0 + (theta - 2.0) ** 2)
    actual = spectra_by_theta(recording(theta, x[:, None]), Scale(0.0, 4.0), DT)
    assert actual.u == pytest.approx([0.0, 0.25, 0.5, 0.75, 1.0])


def test_spectra_hold_the_power_of_the_oscillation():
    theta = staircase(np.linspace(0.0, 1.0, 9), 1600)
    x = oscillating(theta, 1.0, lambda theta: 1.0 + theta)
    actual = spectra_by_theta(recording(theta, x[:, None]), UNIT, DT)
    step = float(actual.frequency[1] - actual.frequency[0])
    power = actual.density[:, 0].sum(axis=-1) * step  # Parseval, but for the two lowest bins
    assert power == pytest.approx(0.5 * (1.0 + actual.u) ** 2 + 0.09, rel=0.05)
    assert actual.frequency[int(np.argmax(actual.power[8, 0]))] == pytest.approx(1.0, abs=step)
    assert actual.sure[0, int(np.argmax(actual.power[8, 0]))]


@pytest.mark.parametrize("repeats", [1, 3])
def test_noise_that_theta_does_not_change_is_sure_as_often_as_chance_has_it(repeats):
    theta = staircase(np.linspace(0.0, 1.0, 9), 1600, repeats)
    noise = np.random.default_rng(0).normal(0.0, 0.3, (theta.size, 3))
    sure = spectra_by_theta(recording(theta, noise), UNIT, DT).sure
    # as of 300 independent ones: of the parts as many bins are 16 times as wide
    assert sure.mean() < 0.01 + 4.0 * math.sqrt(0.01 / 150)


@pytest.mark.parametrize("repeats", [1, 2])
def test_an_oscillation_that_theta_doubles_is_sure_and_a_weak_line_is_interference(repeats):
    values, found = np.linspace(0.0, 1.0, 12), []
    for seed in range(8):
        theta = np.concatenate(
            [np.random.default_rng([seed, i]).permutation(values) for i in range(repeats)]
        ).repeat(1600)
        x = oscillating(theta, 3.01, lambda theta: 0.2 * (1.0 + np.abs(2.0 * theta - 1.0)), seed)
        x += 0.05 * np.sin(2.0 * np.pi * 7.03 * np.arange(theta.size) * DT)
        actual = spectra_by_theta(recording(theta, x[:, None]), UNIT, DT)
        bins = [int(np.argmin(np.abs(actual.frequency - f))) for f in (3.01, 7.03)]
        found.append(actual.sure[0, bins])
    line, weak = np.sum(found, axis=0)
    assert (line, weak <= 1) == (8, True)  # by chance one in a hundred


def test_the_map_of_a_recording_is_that_of_what_reacts():
    theta = staircase(np.linspace(0.0, 1.0, 9), 1600, 2)
    x = np.column_stack([
        oscillating(theta, 1.0, lambda theta: 3.0 + 0.0 * theta, 1),
        oscillating(theta, 1.0, lambda theta: 0.5 + 4.0 * (theta - 0.5) ** 2, 2),
    ])  # fmt: skip
    loaded = recording(theta, x)
    windows = Windows(200, DT)
    holds = find_holds(loaded, UNIT, windows.length)
    assert [hold.u for hold in holds] == pytest.approx([*np.linspace(0.0, 1.0, 9)] * 2)
    assert [hold.side for hold in holds[:2]] == [0, 1]
    assert holds[3].size == 1600
    assert holds[3].x.tolist() == x[4800:6400].tolist()
    amplitude = choose_amplitude(windows, [hold.powers(windows) for hold in holds])
    assert not amplitude.weight[0].any()
    actual = find_dwells(loaded, UNIT, amplitude, 1.0)
    static_map = actual.static_map(actual.logs, 1.0)
    truth = np.log((0.5 + 4.0 * (static_map.u - 0.5) ** 2) / 1.5)
    assert np.abs(static_map.mean - truth).max() < 0.1
    assert static_map.best() == 0.5
    whole = actual.window_levels(x[:, 0])
    assert np.exp(np.concatenate(whole)) == pytest.approx(
        np.full(8 * 18, np.sqrt(4.5 + 0.09)), rel=0.1
    )


def test_rests_of_a_map_that_moves_are_where_they_would_be_now():
    way, values = 0.3, np.r_[np.linspace(0.0, 1.0, 9), np.linspace(0.9, 0.1, 8)]
    logs = [  # the optimum is at 0.3 first and at 0.6 at last
        np.log(0.5 + 4.0 * (u - 0.3 - way * k / 16.0) ** 2) + 0.02 * np.resize([1.0, -1.0], 20)
        for k, u in enumerate(values)
    ]
    u, level = np.unique(values, return_inverse=True)
    rests = [Rest(int(i), 2000 * k, 2000 * (k + 1)) for k, i in enumerate(level)]
    still = replace(make_dwells(rests, logs, 100), u=u)
    static_map, moved = still.now(still.static_map(logs, 1.0))
    assert static_map.best() == pytest.approx(0.6, abs=0.06)
    at = np.array([moved.u[rest.level] for rest in moved.rests])
    assert at - values == pytest.approx(way * np.linspace(1.0, 0.0, 17), abs=0.03)
    assert moved.static_map(logs, 1.0).best() == static_map.best()
