"""Messages that are missing are told from late ones, also where nothing but arrival says so."""

import numpy as np
import pytest

from koop_commission.fitness.arrivals import lost_by_arrival, rhythm

DT = 0.005
N = 8000
RNG = np.random.default_rng(0)


def unstamped(arrival):
    return rhythm(arrival, np.zeros(arrival.size), np.full(arrival.size, -1), DT)


def test_of_38251_sent_and_22031_received_the_others_are_lost():
    sent = np.arange(38251) * DT
    kept = np.sort(RNG.choice(sent.size, 22031, replace=False))
    found = unstamped(sent[kept] + RNG.uniform(0, 0.1 * DT, kept.size))
    ends = kept[0] + sent.size - 1 - kept[-1]  # before the first and after the last: nobody sees
    assert found.source == "arrival"
    assert found.lost == pytest.approx(38251 - 22031 - ends, rel=0.01)
    assert found.share == pytest.approx(0.42, abs=0.01)


@pytest.mark.parametrize("drift", [0.0, 3e-4, -3e-4])
def test_jitter_a_drifting_clock_and_a_stall_lose_nothing(drift):
    sent = np.arange(N) * DT * (1.0 + drift) + RNG.uniform(0, 0.3 * DT, N)
    stalled = np.maximum(sent, np.where(sent > 10.0, 10.4, 0.0))  # 80 come at once, late
    assert lost_by_arrival(stalled, DT) == 0


def test_a_pause_of_the_source_counts_as_what_it_did_not_send():
    arrival = np.arange(N) * DT
    assert lost_by_arrival(np.delete(arrival, slice(1000, 1100)), DT) == 100


def test_a_source_that_is_slower_than_the_file_says_shows_in_the_interval():
    assert unstamped(np.arange(N) * 2.0 * DT).interval == pytest.approx(2.0 * DT)


def test_stamps_and_steps_say_what_is_missing_whatever_the_arrival():
    arrival = np.sort(RNG.uniform(0, N * DT, N - 3))
    kept = np.delete(np.arange(N), [5, 600, 601])
    stamps = rhythm(arrival, 1e9 + kept * DT, np.full(N - 3, -1), DT)
    assert (stamps.source, stamps.lost) == ("stamps", 3)
    steps = rhythm(arrival, np.zeros(N - 3), kept, DT)
    assert (steps.source, steps.lost) == ("steps", 3)
    assert stamps.interval == pytest.approx(DT, rel=1e-4)
