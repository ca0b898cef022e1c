"""Tones that theta does not change, beside oscillations that are known exactly."""

import math
from functools import partial

import numpy as np
import pytest

from koop_tune.excitation.amplitude import Windows, choose_amplitude
from koop_tune.excitation.holds import Hold
from koop_tune.excitation.steady import unsteady_shares

DT, LENGTH, COUNT = 0.02, 400, 16
WINDOWS = Windows(LENGTH, DT)
U = np.array([0.0, 0.25, 0.5, 0.75, 1.0, 0.6, 0.4, 0.5, 0.1, 0.9, 0.45, 0.55])
FREQUENCY, TONE, BEAT = 2.0, 6.1, 400.0  # [Hz], [Hz], [s]; a hold takes 128 s


def group_of(frequency):
    return int(np.argmin(np.abs(WINDOWS.frequency - frequency)))


def recorded(amplitude, wander=0.02, turn=0.0, tone=1.0, follows=0.0):
    """Return holds of a rig of an amplitude by theta, some samples apart, beside two tones.

    ``wander`` is that of its phase [rad] in a sample, ``turn`` the change of its frequency with
    theta, and ``follows`` what theta makes of the tones.
    """
    rng, holds, began, phase = np.random.default_rng(4), [], 37, 0.0
    for number, u in enumerate(U):
        t = DT * (began + np.arange(COUNT * LENGTH))
        steps = 2.0 * np.pi * DT * FREQUENCY * (1.0 + turn * u) + wander * rng.normal(size=t.size)
        own = phase + np.cumsum(steps)
        tones = np.sin(2.0 * np.pi * TONE * t) + np.sin(2.0 * np.pi * (TONE + 1.0 / BEAT) * t + 1.0)
        x = amplitude(u) * np.sin(own) + tone * (1.0 + follows * u) * tones
        x += 0.02 * rng.normal(size=t.size)
        holds.append(Hold(u, 1, x[:, None], number, began=began * DT))
        began, phase = began + t.size + rng.integers(1, 3 * LENGTH), own[-1]
    return holds


def bowl(u):
    return 0.1 + 20.0 * (u - 0.45) ** 2


@pytest.mark.parametrize(("wander", "turn"), [(0.02, 0.0), (0.0, 0.003)])
def test_of_two_tones_hardly_anything_is_left_and_of_an_oscillation_most(wander, turn):
    holds = recorded(bowl, wander, turn)
    assert unsteady_shares(WINDOWS, holds, 0, group_of(TONE)).max() < 0.03
    assert unsteady_shares(WINDOWS, holds, 0, group_of(FREQUENCY)).max() > 1.0


def test_tones_whose_phase_is_not_known_from_hold_to_hold_are_not_taken_for_steady():
    holds = recorded(bowl)
    assert unsteady_shares(WINDOWS, holds[:1], 0, group_of(TONE)) == [1.0]  # too little to tell
    for number, hold in enumerate(holds):
        hold.began += number % 3
    assert unsteady_shares(WINDOWS, holds, 0, group_of(TONE)).max() > 0.5
    holds[0].began = math.nan
    assert unsteady_shares(WINDOWS, holds, 0, group_of(TONE))[0] == 0.0


@pytest.mark.parametrize("began", range(0, LENGTH // 8, 7))
def test_holds_of_two_windows_are_long_enough_whenever_they_began(began):
    rng = np.random.default_rng(1)
    holds = [
        Hold(u, 1, rng.normal(size=(2 * LENGTH, 1)), began=DT * (began + 3 * k * LENGTH))
        for k, u in enumerate([*U, *U])
    ]
    assert unsteady_shares(WINDOWS, holds, 0, 3).shape == (24,)  # failed before


def test_tones_that_beat_slower_than_theta_moves_are_left_out():
    holds = recorded(bowl)
    powers = [hold.late(WINDOWS) for hold in holds]
    unsteady = partial(unsteady_shares, WINDOWS, holds)
    fooled = choose_amplitude(WINDOWS, powers)
    amplitude = choose_amplitude(WINDOWS, powers, unsteady=unsteady)
    assert fooled.weight[0, group_of(TONE)] > 0.0  # what theta is said to change
    assert amplitude.weight[0, group_of(TONE)] == 0.0
    assert amplitude.weight[0, group_of(FREQUENCY)] > 0.0
    levels = np.array([np.sqrt(amplitude.squares(p).mean()) for p in powers])
    assert levels == pytest.approx(bowl(U) / bowl(1.0), rel=0.03)


def test_a_tone_to_which_theta_changes_the_response_stays():
    holds = recorded(lambda u: 0.05 * (1.0 + u), tone=3.0, follows=0.6)
    powers = [hold.late(WINDOWS) for hold in holds]
    unsteady = partial(unsteady_shares, WINDOWS, holds)
    assert unsteady(0, group_of(TONE)).max() < 0.5
    assert choose_amplitude(WINDOWS, powers, unsteady=unsteady).weight[0, group_of(TONE)] > 0.0
