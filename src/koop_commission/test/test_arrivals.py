"""Lost messages are distinguished from late ones, also where only the arrival shows them."""

import numpy as np
import pytest

from koop_commission.fitness.arrivals import count_lost_by_arrival, measure_rhythm
from koop_commission.fitness.samples import Samples
from koop_core.errors import InputError

DT = 0.005
N = 8000
RNG = np.random.default_rng(0)


def samples(arrival, stamp=None, step=None):
    """Return samples of one channel; without stamp or step where none is given."""
    n = arrival.size
    return Samples(
        arrival,
        np.zeros(n) if stamp is None else stamp,
        np.full(n, -1) if step is None else step,
        np.zeros((n, 1)),
    )


def test_of_38251_sent_and_22031_received_the_others_are_lost():
    sent = np.arange(38251) * DT
    kept = np.sort(RNG.choice(sent.size, 22031, replace=False))
    rhythm = measure_rhythm(samples(sent[kept] + RNG.uniform(0, 0.1 * DT, kept.size)), DT)
    ends = kept[0] + sent.size - 1 - kept[-1]  # before the first and after the last: not seen
    assert rhythm.source == "arrival"
    assert rhythm.lost == pytest.approx(38251 - 22031 - ends, rel=0.01)
    assert rhythm.share == pytest.approx(0.42, abs=0.01)


@pytest.mark.parametrize("drift", [0.0, 3e-4, -3e-4])
def test_jitter_a_drifting_clock_and_a_stall_lose_nothing(drift):
    sent = np.arange(N) * DT * (1.0 + drift) + RNG.uniform(0, 0.3 * DT, N)
    stalled = np.maximum(sent, np.where(sent > 10.0, 10.4, 0.0))  # 80 come at once, late
    assert count_lost_by_arrival(stalled, DT) == 0


def test_a_pause_of_the_source_counts_as_the_messages_that_it_did_not_send():
    arrival = np.arange(N) * DT
    assert count_lost_by_arrival(np.delete(arrival, slice(1000, 1100)), DT) == 100


def test_a_source_that_is_slower_than_the_file_says_shows_in_the_interval():
    assert measure_rhythm(samples(np.arange(N) * 2.0 * DT), DT).interval == pytest.approx(2.0 * DT)


def test_messages_without_stamps_that_come_in_bursts_have_the_interval_at_which_they_were_sent():
    sent = np.arange(N) * DT
    bursts = np.ceil(sent / (5.0 * DT)) * 5.0 * DT + 1e-5 * np.arange(N)  # five at once
    assert measure_rhythm(samples(bursts), DT).interval == pytest.approx(DT, rel=0.01)


@pytest.mark.parametrize("kept", [slice(None), slice(3, None, 2)])
def test_a_rig_at_another_pace_has_its_own_interval_and_the_clocks_rate(kept):
    sent = np.arange(N) * DT / 4.0  # simulated at four times real time
    steps = np.arange(N)[kept]
    rhythm = measure_rhythm(samples(sent[kept], step=steps), DT, pace=4.0)
    assert rhythm.interval == pytest.approx(DT)
    assert rhythm.rate == pytest.approx((steps.size - 1) / (sent[kept][-1] - sent[kept][0]))
    assert (
        rhythm.lost == N - 3 * (kept.start is not None) - steps.size - (kept.start is not None) * 0
    )


def test_stamps_and_steps_show_losses_whatever_the_arrival():
    arrival = np.sort(RNG.uniform(0, N * DT, N - 3))
    kept = np.delete(np.arange(N), [5, 600, 601])
    stamps = measure_rhythm(samples(arrival, stamp=1e9 + kept * DT), DT)
    assert (stamps.source, stamps.lost) == ("stamps", 3)
    steps = measure_rhythm(samples(arrival, step=kept), DT)
    assert (steps.source, steps.lost) == ("steps", 3)
    assert stamps.interval == pytest.approx(DT, rel=1e-4)


def test_too_few_messages_are_refused():
    few = samples(np.arange(10) * DT)
    with pytest.raises(InputError, match="10 messages arrived, 20 are needed"):
        measure_rhythm(few, DT)
