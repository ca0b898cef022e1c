"""Faults at random on a loop of its own, and the program that judges them."""

import json
import re
import struct
from collections.abc import Callable

import numpy as np
import pytest
from mcap.writer import Writer

from koop_hil import chaos
from koop_hil.chaos_verdict import judge
from koop_lab.cli.main import main

SHORT = 6  # faults
T = 1.7e9  # [s] some time of the day


def write(folder, log, faults=(), left=(), follows=True, grows=1):
    """Write the files of a run with these lines of the rig's log and these faults."""
    np.savetxt(folder / "rig.csv", log, delimiter=",", fmt="%.6f")
    events = [{"time": T, "what": "loop started", "number": 1}]
    for kind, begin, end in faults:
        events.append({"time": T + begin, "what": "fault", "kind": kind, "on": True,
                       "memory": {"guard": 100 + grows * len(events)}})  # fmt: skip
        events.append({"time": T + end, "what": "fault", "kind": kind, "on": False, "memory": {}})
    events.append({"time": T, "what": "settled", "follows": follows})
    events.append({"time": T + 60.0, "what": "loop ended", "code": 0})
    events.append({"time": T, "what": "end", "left": list(left)})
    (folder / "events.jsonl").write_text("\n".join(map(json.dumps, events)))


def healthy() -> np.ndarray:
    """Return the log of a minute in which theta is commanded at each sample."""
    t = T + 0.005 * np.arange(12000)
    theta = 0.5 + np.sin(t)
    return np.column_stack([t, t * 1e9, theta, theta, 0 * t, 0 * t])


def beyond(log):
    log[6000:6200, 2:4] = 4.5


def too_fast(log):
    log[6000:6200, 2:4] += 1.0


def nobody(log):
    log[2000:5000, 3] = np.nan
    log[2000:5000, 4] = 20.0


BROKEN: dict[str, Callable[[np.ndarray], None]] = {
    "commands from ": beyond,
    "theta .* to .* in 0.005 s": too_fast,
    "unguarded for 15.0 s": nobody,
}


@pytest.mark.parametrize("words", BROKEN)
def test_what_the_rig_must_not_see_is_found(tmp_path, words):
    log = healthy()
    write(tmp_path, log, [("kill guard", 25.0, 26.0)])
    assert judge(tmp_path).failures == []
    BROKEN[words](log)
    write(tmp_path, log, [("kill guard", 10.0, 11.0)])
    assert re.search(words, "\n".join(judge(tmp_path).failures))


def test_theta_must_be_safe_while_the_sensors_say_what_cannot_be(tmp_path):
    log, fault = healthy(), ("sensor nan", 10.0, 40.0)
    write(tmp_path, log, [fault])
    verdict = judge(tmp_path)
    assert verdict.worst["sensor nan"] == pytest.approx(30.1, abs=0.02)
    assert len(verdict.failures) == 1
    log[2100:8200, 2] = 2.0
    write(tmp_path, log, [fault])
    assert judge(tmp_path).failures == []


def test_processes_that_stay_memory_that_grows_and_a_loop_that_does_not_return(tmp_path):
    faults = [("kill lifter", t, t + 1.0) for t in range(5, 50, 5)]
    write(tmp_path, healthy(), faults, ["koop_guard"], False, grows=10)
    failures = " ".join(judge(tmp_path).failures)
    assert "left behind: koop_guard" in failures
    assert "guard takes 270 kB at last, 150 kB at first" in failures
    assert "did not run again" in failures


@pytest.mark.parametrize(
    ("sent", "killed", "words"),
    [
        (range(2000, 9000), None, None),
        ([*range(2000, 4000), *range(4003, 9000)], None, "3 samples missing"),
        (range(2000, 9000), 45.1, None),
        (range(2000, 9000), 45.5, "ends 0.51 s before its recorder was killed"),
    ],
)
def test_samples_that_a_recording_lacks_are_counted(tmp_path, sent, killed, words):
    log = healthy()
    folder = tmp_path / "loop-1" / "bag"
    folder.mkdir(parents=True)
    with (folder / "bag_0.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        topic = writer.register_channel("/rig/state", "cdr", 0)
        for i in sent:
            seconds, rest = divmod(int(f"{1e9 * log[i, 0]:.0f}"), 10**9)
            writer.add_message(topic, 0, struct.pack("<4xiI", seconds, rest), 0)
        writer.finish()
    write(tmp_path, log, [("kill recorder", killed, 50.0)] if killed else [])
    failures = judge(tmp_path).failures
    assert len(failures) == (words is not None)
    assert words is None or words in failures[0]


@pytest.mark.ros
def test_a_loop_under_faults_at_random_keeps_the_rig_safe(tmp_path, own_domain, capfd):
    out = tmp_path / "run"
    assert main(["hil", "chaos", "--seed", "51", "--faults", str(SHORT), "--out", str(out)]) == 0, (
        capfd.readouterr().out
    )
    verdict = judge(out)
    assert verdict.faults.total() == SHORT
    assert len(chaos.KINDS) >= 20
