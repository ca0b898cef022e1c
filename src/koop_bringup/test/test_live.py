"""Node processes: started, watched, and none left behind."""

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress

import pytest

from koop_bag.bag.earlier import NAMED
from koop_bringup.live.health import describe_loop, judge_health
from koop_bringup.live.loop import LiveNodes
from koop_bringup.live.monitor import Progress
from koop_bringup.live.notify import ServiceManager
from koop_bringup.live.process import NodeProcess
from koop_bringup.plan import Plan
from koop_core.ended import Ended, read_end
from koop_core.errors import LiveError
from koop_guard.note import STOOD_STILL

# Ends when it is told to, and until then lets its parent be told once more.
ENDS_LATE = """
import os, signal, sys
from koop_node.process.lifeline import end_with_parent
def on_signal(number, frame):
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a handler in its own handler cannot print
    os.kill(os.getppid(), signal.SIGINT)
    print("ended", flush=True)
    sys.exit(0)
signal.signal(signal.SIGINT, on_signal)
end_with_parent()
print("started", flush=True)
while True:
    signal.pause()
"""

FOREIGN = """
import signal, sys
signal.signal(signal.SIGINT, lambda *_: sys.exit(0))
print("started", flush=True)
while True:
    signal.pause()
"""


def test_ctrl_c_that_comes_again_does_not_keep_a_node_from_being_stopped(tmp_path):
    log = tmp_path / "node.log"
    node = NodeProcess("node", [ENDS_LATE], log, [sys.executable, "-c"])
    while "started" not in log.read_text():
        assert node.poll() is None
    handler = signal.getsignal(signal.SIGINT)
    try:
        assert node.stop() == 0
    except KeyboardInterrupt:
        node.process.kill()
        pytest.fail("the second Ctrl-C ended the stopping, not the node")
    assert "ended" in log.read_text()
    assert signal.getsignal(signal.SIGINT) is handler


def test_a_node_that_hung_as_it_left_the_domain_has_done_its_work(tmp_path):
    hung = FOREIGN.replace("sys.exit(0)", "signal.raise_signal(signal.SIGALRM)")
    node = NodeProcess("node", [hung], tmp_path / "node.log", [sys.executable, "-c"])
    while node.last_lines() != "started":
        assert node.poll() is None
    run = LiveNodes(tmp_path, Plan({}))
    run._nodes["node"] = node
    run.end()  # which is no failure
    assert node.stop() == 0
    assert node.poll() == -signal.SIGALRM


def test_a_recorder_that_was_lost_is_an_alarm(tmp_path):
    """Failed before: a line on a terminal, at which nobody may look."""
    (tmp_path / "logs").mkdir()
    facts = tmp_path / "facts"
    guard = {"command": "/b:z", "on_alarm": f"sh -c 'env > {facts}.new; mv {facts}.new {facts}'"}
    run = LiveNodes(tmp_path, Plan({"koop_guard": guard, "recorder": {}}, rig=True))
    dies = "import os; os.kill(os.getpid(), 9)"
    node = NodeProcess("recorder", [dies], tmp_path / "log", [sys.executable, "-c"])
    run._nodes["recorder"] = node
    node.process.wait()
    assert not run._done()
    assert not run._done()  # once
    (alarm,) = run._alarms
    deadline = time.monotonic() + 30.0
    while alarm._running and time.monotonic() < deadline:
        alarm.check()
        time.sleep(0.05)
    told = facts.read_text()
    reason = "recorder was killed by signal 9: the loop goes on without it"
    assert f"KOOP_ALARM_REASON={reason}\n" in told
    assert "KOOP_ALARM_NODE=recorder\n" in told
    assert len(run.notes) == 1


def test_what_a_killed_node_said_long_before_is_not_its_reason(tmp_path):
    """Failed before: warnings that were over stood behind "was killed by signal 9:"."""
    node = NodeProcess("node", [FOREIGN], tmp_path / "node.log", [sys.executable, "-c"])
    while node.last_lines() != "started":
        assert node.poll() is None
    node.process.kill()
    node.process.wait()
    assert str(node.failure()) == f"node was killed by signal 9 ({tmp_path / 'node.log'})"


def test_a_guard_that_its_twin_ended_was_not_just_killed(tmp_path):
    """Failed before: "killed by signal 9", as by anybody."""
    words = f"print('{STOOD_STILL} 8 s: its twin ended it', flush=True); os.kill(os.getpid(), 9)"
    log = tmp_path / "guard.log"
    guard = NodeProcess("koop_guard", [f"import os; {words}"], log, [sys.executable, "-c"])
    guard.process.wait()
    how = "koop_guard was killed by signal 9: the guard stood still for 8 s: its twin ended it"
    assert guard.end() == how
    assert str(guard.failure()) == f"{how} ({log})"


@pytest.mark.ros
@pytest.mark.parametrize("delay", [0.0, 0.03, 0.06, 0.1])
def test_a_node_that_is_stopped_before_it_has_started_ends_as_any_other(tmp_path, delay):
    """Python itself would print a traceback, and end with exit code 1 or -2."""
    node = NodeProcess("relay_esc", [], tmp_path / "node.log")
    time.sleep(delay)  # of its start, which shows nothing that could be waited for
    assert node.stop(timeout=240) == 0
    assert node.last_lines() == ""


def test_a_node_is_out_of_reach_of_ctrl_c_and_shares_the_processors_with_its_starter(tmp_path):
    node = NodeProcess("node", [ENDS_LATE], tmp_path / "node.log", [sys.executable, "-c"])
    try:
        assert os.getpgid(node.process.pid) != os.getpgrp()  # a terminal interrupts a group
        if sys.version_info >= (3, 11):  # Linux shares out by session
            assert os.getsid(node.process.pid) == os.getsid(0)
    finally:
        node.process.kill()
        node.process.wait()


# Starts a process that ends with it, from a thread that is over at once, and says its number.
PARENT = """
import sys, threading, time
from koop_bringup.live.process import TiedProcess
child = []
command = [sys.executable, "-c", sys.argv[1]]
thread = threading.Thread(target=lambda: child.append(TiedProcess(command)))
thread.start()
thread.join()
time.sleep(600)
"""
CHILD = """
import os, signal, sys, time
from koop_node.process.lifeline import end_with_parent
def on_signal(number, frame):
    os.write(1, b"told to stop\\n")  # print may be under way
    sys.exit(0)
signal.signal(signal.SIGTERM, on_signal)
end_with_parent()
print(os.getpid(), flush=True)
while True:
    time.sleep(0.05)  # one long sleep that begins right after a signal would not see it
"""


@pytest.mark.parametrize("stopped", [False, True])
def test_a_process_ends_in_order_when_its_parent_is_killed(stopped):
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, CHILD], stdout=subprocess.PIPE, text=True
    )
    child = int(parent.stdout.readline())
    if stopped:
        os.kill(child, signal.SIGSTOP)
    parent.kill()
    # the pipe has an end when nobody is left who could write to it
    assert parent.stdout.read() == "told to stop\n"
    parent.wait()


def test_a_process_that_nobody_tied_does_not_look_at_its_stdin():
    ends = CHILD.replace("while True:\n    time.sleep(0.05)", "time.sleep(0.2)")
    done = subprocess.run(
        [sys.executable, "-c", ends],
        stdin=subprocess.DEVNULL, capture_output=True, text=True, check=True, timeout=240,
    )  # fmt: skip
    assert "told" not in done.stdout


def test_a_file_of_the_recording_that_goes_meanwhile_is_not_counted(tmp_path):
    """Failed before: who asked for the status just then ended the loop."""
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "kept.mcap").write_bytes(bytes(1_500_000))
    (tmp_path / "bag" / "dropped.mcap").symlink_to("nowhere")
    text = describe_loop(Progress(), [], {}, tmp_path, True, 1.0, 2.0)
    assert "recording, 1.5 MB" in text


@pytest.mark.parametrize(
    ("parameters", "rig"),
    [
        ({"koopman_lifter": {}}, "measured state"),
        ({"koopman_lifter": {"measured": "/a:x"}}, "measured /a:x"),
        ({"vdp_plant": {}, "koopman_lifter": {}}, "the simulated plant"),
        ({"koop_guard": {"measured": "/a:x", "command": "/b:z"}}, "measured /a:x, command /b:z"),
        # failed before: who asked for the status ended the loop
        ({"koop_guard": {"command": "/b:z"}}, "measured state:x[0], command /b:z"),
    ],
)
def test_a_status_names_the_rig_also_by_defaults(tmp_path, parameters, rig):
    text = describe_loop(Progress(), [], parameters, tmp_path, False, 1.0, 2.0)
    assert f"\n  rig: {rig}\n" in text


def test_a_loop_that_stands_still_gives_a_sign_of_life_only_if_a_node_of_it_says_why(
    tmp_path, monkeypatch
):
    """Failed before: any driver that warned for good kept a loop that hung from its restart."""
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.setblocking(False)
        service, progress = ServiceManager(), Progress(step=7)

        def is_alive():
            progress.heard["relay_esc"] = time.monotonic()
            service.report(progress, ["relay_esc"], "healthy")
            try:
                return manager.recv(4096).startswith(b"READY=1\nWATCHDOG=1\n")
            except BlockingIOError:
                return False

        assert [is_alive(), is_alive()] == [True, False]
        progress.findings["camera"] = "camera WARN: cold"
        assert not is_alive()
        progress.findings["relay_esc"] = "relay_esc STALE: nothing on 'cost'"
        assert is_alive()


def test_a_program_that_knows_nothing_of_ours_ends_on_sigint(tmp_path):
    log = tmp_path / "rig.log"
    rig = NodeProcess("rig", [FOREIGN], log, [sys.executable, "-c"])
    while "started" not in log.read_text():
        assert rig.poll() is None
    assert rig.stop() == 0


def test_an_error_of_another_program_is_told_apart_from_the_health_of_the_loop(tmp_path):
    said = {"relay_esc": 0, "camera_driver": 2}
    findings = {"camera_driver": "camera_driver ERROR: no picture"}
    progress = Progress(levels=said, findings=findings, heard=dict.fromkeys(said, 1.0))
    assert judge_health(progress, ["relay_esc"], [], 2.0) == []
    text = describe_loop(progress, [], {"relay_esc": {}}, tmp_path, False, 1.0, 2.0)
    assert "  healthy\n" in text
    assert text.endswith("not of this loop, on /diagnostics: camera_driver ERROR: no picture")
    own = Progress(levels={"relay_esc": 2}, findings={"relay_esc": "relay_esc ERROR: no cost"},
                   heard={"relay_esc": 1.0})  # fmt: skip
    assert judge_health(own, ["relay_esc"], [], 2.0) == ["relay_esc ERROR: no cost"]
    assert "not of this loop" not in describe_loop(
        own, [], {"relay_esc": {}}, tmp_path, False, 1.0, 2.0
    )


def test_the_status_of_a_healthy_loop_shows_what_its_nodes_warn_of(tmp_path):
    """Failed before: it said "healthy", and the warnings were in the terminal of koop up alone."""
    nodes = {"koopman_lifter": {}, "recorder": {}}
    findings = {
        "koopman_lifter": "koopman_lifter WARN: the rig has changed",
        "recorder": "recorder WARN: bag/alarms is full",
    }
    progress = Progress(
        levels=dict.fromkeys(nodes, 1), findings=findings, heard=dict.fromkeys(nodes, 1.0)
    )
    assert judge_health(progress, nodes, [], 2.0) == []
    text = describe_loop(progress, [], nodes, tmp_path, True, 1.0, 2.0)
    assert text.startswith(
        "  healthy\n  koopman_lifter WARN: the rig has changed\n"
        "  recorder WARN: bag/alarms is full\n  theta"
    )


@pytest.mark.parametrize(
    ("error", "failure"), [(None, ""), (KeyboardInterrupt, ""), (LiveError("no disk"), "no disk")]
)
def test_the_logs_note_how_a_loop_ended_and_before_that_it_did_not(
    tmp_path, own_domain, error, failure
):
    """Failed before: nothing was left of it but words on a terminal."""
    with suppress(KeyboardInterrupt, LiveError), LiveNodes(tmp_path, Plan({})):
        assert read_end(tmp_path / "logs") == Ended()
        if error is not None:
            raise error
    ended = read_end(tmp_path / "logs")
    assert abs(ended.time - time.time()) < 60.0
    assert ended.failure == failure


def test_a_node_that_ended_is_noted_as_the_failure_or_as_lost(tmp_path):
    for role, rig in (("relay_esc", True), ("recorder", True)):
        folder = tmp_path / role
        for name in ("logs", "bag", "summary"):  # as of a ring
            (folder / name).mkdir(parents=True)
        for number in range(9, 12):
            (folder / "bag" / f"bag_{number}.mcap").touch()
        run = LiveNodes(folder, Plan({role: {}}, rig=rig))
        run._nodes[role] = node = NodeProcess(
            role, ["import os; os.kill(os.getpid(), 9)"], folder / "log", [sys.executable, "-c"]
        )
        node.process.wait()
        with suppress(LiveError):
            run._done()
        ended = read_end(folder / "logs")
        told = ended.failure or ended.lost[0][1]
        assert told == f"{role} was killed by signal 9"
        assert bool(ended.lost) == (role == "recorder")
    # failed before: who was killed names no files to be kept
    assert (folder / "bag" / NAMED).read_text().split() == ["bag_10.mcap", "bag_11.mcap"]


def test_what_a_guard_said_long_ago_is_no_health(tmp_path):
    """Failed before: a loop whose guard stood still for 8 s was healthy, at a theta of then."""
    nodes = {"koop_guard": {"command": "/b:z"}, "relay_esc": {}}
    progress = Progress(
        theta=[0.5], values={"koop_guard": {"status": "following"}},
        levels=dict.fromkeys(nodes, 0), heard={"koop_guard": 100.0, "relay_esc": 104.0},
    )  # fmt: skip

    def describe(now):
        faults = judge_health(progress, nodes, [], now)
        return describe_loop(progress, faults, nodes, tmp_path, False, 1.0, now)

    assert "  healthy\n  theta = 0.5, guard following\n" in describe(102.0)
    text = describe(105.0)
    assert "  not healthy: koop_guard is silent for 5 s\n" in text
    assert "  theta = 0.5, guard following, 5 s ago\n" in text
    assert "relay_esc is silent for 11 s" in describe(115.0)


# Says, when its lifeline ends it, why the loop ends.
ASKS = """
import signal, sys, time
from koop_core.ended import Told
from koop_node.process.lifeline import end_with_parent
told = Told()
def on_signal(number, frame):
    time.sleep(0.2)
    print(told.why(), flush=True)
    sys.exit(0)
signal.signal(signal.SIGTERM, on_signal)
end_with_parent()
print("started", flush=True)
while True:
    time.sleep(0.05)
"""
LOOP = """
import os, sys, time
from pathlib import Path
from koop_bringup.live.loop import LiveNodes
from koop_bringup.live.process import NodeProcess
from koop_bringup.plan import Plan
from koop_core.errors import LiveError
folder, how, program = Path(sys.argv[1]), sys.argv[2], sys.argv[3]
with LiveNodes(folder, Plan({})) as run:
    python = [sys.executable, "-c"]
    node = NodeProcess("node", [program], folder / "node.log", python, run._environment)
    run._nodes["koop_guard"] = node
    while node.last_lines() != "started":
        time.sleep(0.01)
    if how == "killed":
        os.kill(os.getpid(), 9)
    if how == "failed":
        dies = "import os; os.kill(os.getpid(), 9)"
        dead = NodeProcess("relay_esc", [dies], folder / "dead.log", python)
        dead.process.wait()
        run._nodes["relay_esc"] = dead
        run._done()
    raise {"broken": LiveError("no room"), "ended": KeyboardInterrupt()}[how]
"""


@pytest.mark.ros
@pytest.mark.parametrize(
    ("how", "why"),
    [
        ("failed", "relay_esc was killed by signal 9"),
        ("killed", "the process that started the loop was killed"),
        ("broken", "no room"),
        ("ended", "the loop ends"),
    ],
)
def test_a_guard_is_told_why_the_loop_ends(tmp_path, how, why):
    """Failed before: an alarm said "the loop ends", whatever had died."""
    words = [sys.executable, "-c", LOOP, str(tmp_path), how, ASKS]
    subprocess.run(words, stderr=subprocess.DEVNULL, timeout=60.0, check=False)
    log, deadline = tmp_path / "node.log", time.monotonic() + 30.0
    while log.read_text() == "started\n" and time.monotonic() < deadline:
        time.sleep(0.05)
    assert log.read_text() == f"started\n{why}\n"
