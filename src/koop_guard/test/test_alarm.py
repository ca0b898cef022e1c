"""The user's program that runs at a trip."""

import os
import tempfile
import time

from koop_guard.config import GuardConfig
from koop_guard.guard import Cause, Trip
from koop_guard.node.alarm import Alarm

TRIP = Trip(Cause.ASKED, "~/trip was called", 0.0, (0.5,), (1.0, 2.0))


def test_an_alarm_runs_and_its_failure_is_told_though_the_disk_is_full(monkeypatch):
    """Failed before: the guard, or its twin on the way to theta_safe, ended with a traceback."""
    monkeypatch.setattr(tempfile, "tempdir", "/no/room")
    program = "sh -c 'echo $KOOP_ALARM_CAUSE, no mail >&2; exit 3'"
    reports = []
    alarm = Alarm(GuardConfig("/a:x", "/b:z", on_alarm=program), reports.append)
    for _ in range(2):  # once a trip
        alarm.start(TRIP, "/koop_guard")
    deadline = time.monotonic() + 60.0
    while not reports and time.monotonic() < deadline:
        alarm.check()
        time.sleep(0.01)
    (report,) = reports
    assert "failed: exit code 3" in report
    assert report.endswith(": asked, no mail")


def test_a_program_that_is_not_there_is_told():
    reports = []
    Alarm(GuardConfig("/a:x", "/b:z", on_alarm="/no/program"), reports.append).start(TRIP, "guard")
    (report,) = reports
    assert "on_alarm = '/no/program' was not started" in report


def test_a_program_that_says_much_takes_no_memory(tmp_path):
    """Failed before: one that printed in a loop took all of the machine's in its minute."""
    seen = tmp_path / "seen"
    wait = f"while [ ! -e {seen} ]; do sleep 0.01; done"
    program = f"sh -c 'yes | head -c 50000000; {wait}; echo the end >&2; exit 3'"
    reports = []
    alarm = Alarm(GuardConfig("/a:x", "/b:z", on_alarm=program), reports.append)
    alarm.start(TRIP, "/koop_guard")
    ((process, _, said),) = alarm._running
    deadline = time.monotonic() + 60.0
    while os.fstat(said.fileno()).st_size < 50_000_000:
        assert time.monotonic() < deadline
        time.sleep(0.001)
    alarm.check()
    assert os.fstat(said.fileno()).st_size < 10_000_000
    seen.touch()
    assert process.wait(60.0) == 3
    alarm.check()
    assert reports[0].endswith(": the end")
