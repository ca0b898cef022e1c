"""What a recording loses under load: nothing at the loop's rate, and never silently.

Short versions of ``koop bench record``, which takes ten minutes.
"""

import signal
import subprocess
import sys
import time

import pytest

from koop_bag.bag.columns import read_columns
from koop_bag.bag.reader import BagReader
from koop_bag.recorder.config import LOOP_TOPICS
from koop_lab.bench.record import LIMIT, kill_recorders, record_load, reported_losses

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


def test_what_a_stalled_recorder_missed_at_the_end_comes_within_a_second(start, tmp_path):
    # Fast DDS would tell a reader what it lacks every 3 s; a run may end before
    recorder = start("recorder", output=tmp_path / "run")
    command = [sys.executable, "-m", "koop_lab.bench.load", "2000", "1.3"]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as load:
        load.stdout.readline()  # a second has passed
        recorder.process.send_signal(signal.SIGSTOP)
        time.sleep(0.5)  # up to the end of the load, and longer than shared memory holds
        recorder.process.send_signal(signal.SIGCONT)
        resumed = time.monotonic()
        load.stdout.readline()  # all is acknowledged
        assert time.monotonic() - resumed < 1.0
        load.wait()
    assert recorder.stop() == 0
    with BagReader(tmp_path / "run") as bag:
        for topic in LOOP_TOPICS:
            assert read_columns(bag, f"/{topic}", ["step"])["step"][-1] == 2599


def test_a_killed_recorder_lacks_a_fifth_of_a_second_at_most(tmp_path):
    (missing,) = kill_recorders(tmp_path, 1)
    assert missing <= LIMIT


def test_gaps_and_early_ends_add_up():
    log = """3 messages, 9 bytes in /x; lost messages: 12 on /state, 3 on /cost
    /ground_truth ends 7 steps before the loop does
    /state begins at step 100, not at 0"""
    assert reported_losses(log) == 122
    assert reported_losses("lost messages: none") == 0
