"""What a recording loses under load: nothing at the loop's rate, and never silently."""

import pytest
from recording_load import record_load

from koop_bench.record import reported_losses


@pytest.mark.ros
def test_at_200_hz_nothing_is_lost(own_domain, tmp_path):
    report = record_load(tmp_path / "run", 200.0, 2.0)
    assert report.sent == 400
    assert (report.missing, report.counted) == (0, 0), report.text()
    # what a message takes besides its payload is less than a payload, even of random numbers
    assert report.stored < 2 * report.payload, report.text()


@pytest.mark.ros
def test_at_ten_times_the_rate_and_stalled_every_loss_is_reported(own_domain, tmp_path):
    # the queue holds 0.1 s of messages, the recorder does not run for 0.6 s of them
    report = record_load(tmp_path / "run", 2000.0, 2.0, stall=0.6, queue=200)
    assert report.missing > 1000, report.text()
    assert report.counted == report.missing, report.text()


@pytest.mark.ros
def test_what_a_stalled_recorder_missed_at_the_end_it_gets_from_those_who_leave(
    own_domain, tmp_path
):
    # Fast DDS would tell a reader what it lacks every 3 s; a run that is over does not wait for it.
    # 0.4 s at this rate are more than shared memory holds
    report = record_load(tmp_path / "run", 2000.0, 1.4, stall=10.0, farewell=1.0)
    assert report.sent == 2800
    assert report.missing == 0, report.text()


def test_gaps_and_early_ends_add_up():
    log = """3 messages, 9 bytes in /x; lost messages: 12 on /state, 3 on /cost
    /ground_truth ends 7 steps before the loop does
    /state begins at step 100, not at 0"""
    assert reported_losses(log) == 122
    assert reported_losses("lost messages: none") == 0
