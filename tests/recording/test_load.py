"""What a recording loses under load: nothing at the loop's rate, and never silently.

Short versions of ``koop bench record``, which takes ten minutes.
"""

import pytest

from koop_lab.bench_record import LIMIT, kill_recorders, record_load, reported_losses

pytestmark = pytest.mark.ros


def test_at_200_hz_nothing_is_lost_at_a_tenth_of_a_core(tmp_path):
    report = record_load(tmp_path / "run", 200.0, 6.0)
    assert report.sent == 1200
    assert (report.missing, report.counted) == (0, 0), report.text()
    assert report.cpu < 0.1, report.text()
    # what a message takes besides its payload is less than a payload, even of random numbers
    assert report.stored < 2 * report.payload, report.text()


def test_at_ten_times_the_rate_and_stalled_every_loss_is_reported(tmp_path):
    # the queue holds 0.1 s, the recorder does not run for 0.6 s
    report = record_load(tmp_path / "run", 2000.0, 3.0, stall=0.6, queue=200)
    assert report.missing > 1000, report.text()
    assert report.counted == report.missing, report.text()


def test_a_killed_recorder_lacks_a_fifth_of_a_second_at_most(tmp_path):
    (missing,) = kill_recorders(tmp_path, 1)
    assert missing <= LIMIT


def test_gaps_and_early_ends_add_up():
    log = """3 messages, 9 bytes in /x; lost messages: 12 on /state, 3 on /cost
    /truth ends 7 steps before the loop does
    /state begins at step 100, not at 0"""
    assert reported_losses(log) == 122
    assert reported_losses("lost messages: none") == 0
