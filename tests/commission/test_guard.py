"""The guard of ``koop up`` on a foreign rig: whatever fails, theta returns to theta_safe."""

import ctypes
import fcntl
import itertools
import json
import os
import re
import resource
import shlex
import signal
import socket
import struct
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from random import random

import numpy as np
import pytest
from chromium import Chromium
from commission_rig import DT, RIG, TWO_KNOBS, FastRig
from koop_msgs.msg import ControlInput, GuardState, MeasuredState, PlantTruth
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.parameter import Parameter
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import Trigger
from waiting import wait

from koop_bag.bag.columns import read_columns
from koop_bag.bag.reader import BagReader
from koop_core.config import parameter_file
from koop_core.config.objects import to_json
from koop_core.whole_file import read_json
from koop_guard import note
from koop_guard.config import SAFETY
from koop_guard.guard import Cause, Trip
from koop_guard.node.twin import Twin
from koop_hil import installed
from koop_lab.recorded.report import read
from koop_loop import parameters
from koop_loop.parameters import changed
from koop_node.node.executor import Executor
from koop_node.node.qos import KEPT
from koop_node.node.rclpy_internals import WithoutEvents
from koop_node.process.joining import FAST_DDS
from koop_tune.result.parameter_text import KNOWN
from koop_tune.rig import rig_file
from koop_tune.rig.rig_file import as_values
from relay_esc.config import EscConfig

pytestmark = pytest.mark.ros
LONG = 120.0  # [s] to start five processes on a busy machine
SAFE = 1.0
SHARED = ("measured", "command", "dt", "theta_min", "theta_max", "theta_rate", "theta_start",
          "theta_safe", "channel_max")  # fmt: skip
SLOW = replace(RIG, theta_rate=4.0, theta_safe=SAFE)
SLOWER_DT = 0.02  # most tests wait for times of the guard's; each sample costs five processes
LOOP = {
    "koopman_lifter": {
        "cost": "raw", "dt": DT, "omega_h": 100.0, "omega_l": 20.0, "measured": RIG.measured,
    },
    "relay_esc": {
        "step_size": 0.008, "dwell": 0.2, "tau_f": 0.2, "theta_min": -1.0,
        "theta_max": 0.9, "rate_limit": 4.0, "theta_initial": 0.5,
    },
    "koop_guard": {name: as_values(SLOW)[name] for name in SHARED},
}  # fmt: skip


SLOWER_LOOP = {
    "koopman_lifter": {
        **LOOP["koopman_lifter"], "dt": SLOWER_DT, "omega_h": 40.0, "omega_l": 8.0,
    },
    "relay_esc": {**LOOP["relay_esc"], "dwell": 0.5, "tau_f": 0.5},
    "koop_guard": {**LOOP["koop_guard"], "dt": SLOWER_DT},
}  # fmt: skip


@pytest.fixture
def fast_rig(own_domain):
    """Run a rig that is not as fast."""
    rig = FastRig(dt=SLOWER_DT)
    yield rig
    rig.close()


@pytest.fixture
def states(probe):
    """What the guard says of itself."""
    states = []
    probe.node.create_subscription(GuardState, "/koop_guard/state", states.append, KEPT)
    return states


@pytest.fixture
def up(fast_rig, koop, nodes_of, tmp_path, probe, states):
    """Close the loop, and wait until the controller moves the rig."""

    def start(out="run", options=(), **guard):
        values = {**SLOWER_LOOP, "koop_guard": {**SLOWER_LOOP["koop_guard"], **guard}}
        parameter_file.write(values, tmp_path / "loop.yaml")
        text = (tmp_path / "loop.yaml").read_text().replace("/**/", "/")
        (tmp_path / "loop.yaml").write_text(text)
        process = koop("up", "loop.yaml", "--out", out, *options)
        states.clear()
        count = len(fast_rig.moved)
        commands = lambda: follows(probe, states, fast_rig) and len(fast_rig.moved) > count  # noqa: E731
        wait(commands, "the controller to move theta", process, LONG)
        return process, nodes_of(process)

    return start


def follows(probe, states, rig):
    """Return whether the controller moves the rig; after a silence of a busy machine, rearm."""
    probe.executor.spin_once(timeout_sec=0.05)
    if states and states[-1].status == GuardState.TRIPPED and not states[-1].rearm_refused:
        probe.call(Trigger, "/koop_guard/rearm", Trigger.Request())
    return rig.theta < 0.7


def walked(rig):
    """Return whether theta is at theta_safe; limits and rate were kept at every command."""
    theta = [value for _, value in rig.moved]
    assert min(theta) >= SLOW.theta_min
    assert max(theta) <= SLOW.theta_max
    for (before, a), (now, b) in pairwise(rig.moved):
        # a command moves theta by what 40 ms allow at most; some are lost while the rig waits, and
        # the one before may be heard late; a jump home would be further
        assert abs(b - a) <= SLOW.theta_rate * (now - before + 0.1) * (1 + 1e-6)
    return theta[-1] == SAFE


def home(rig, process=None):
    """Wait until theta is at theta_safe and stays there."""
    wait(lambda: rig.theta == SAFE, "theta_safe", process)
    begin = time.monotonic()
    wait(lambda: rig.theta != SAFE or time.monotonic() > begin + 1.0, "a second")
    assert walked(rig)


def alarm(facts, *end):
    """Return an alarm's program that appends its facts to a file."""
    script = "; ".join([f"env | grep KOOP_ALARM_ >> {facts}", f"echo NEXT >> {facts}", *end])
    return shlex.join(["sh", "-c", script])


def check_alarm(facts, reason, rig):
    """Return the facts of the one alarm for a reason, once they are there."""

    def alarms():
        each = facts.read_text().split("NEXT")[:-1] if facts.exists() else []
        return [text for text in each if re.search(f"KOOP_ALARM_REASON=.*({reason})", text)]

    (alarm,) = wait(alarms, "the alarm")
    known = dict(re.findall(r"KOOP_ALARM_(\w+)=(.*)", alarm))
    assert (float(known["THETA_SAFE"]), known["COMMAND"]) == (SAFE, "/fast/knob:data")
    assert any(abs(theta - float(known["THETA"])) < 0.1 for _, theta in rig.moved)
    return known


FAULTS = {
    "spike": lambda rig: setattr(rig, "spike", True),
    "not finite": lambda rig: setattr(rig, "not_finite", True),
    "stuck": lambda rig: setattr(rig, "dead", 1),
    "silent": lambda rig: setattr(rig, "silent", True),
}
REASONS = {
    "spike": ("channel beyond its limit", "data[0] = 99 is beyond its limit 8"),
    "not finite": ("channel not finite", "data[0] on /fast is not a finite number"),
    "stuck": ("channel stuck", "data[1] = 0.5 has not changed for"),
    "silent": ("rig silent", "no message on /fast for "),
}


def check_end(process, nodes, rig, run, code):
    """Theta ends at theta_safe, the recorder after it, and nothing is left behind."""
    home(rig)
    assert process.wait(LONG) == code
    if code >= 0:
        # failed before for a guard that was killed: the recorder ended before its twin was done
        assert "theta is left at 1; theta_safe = 1" in process.stderr.read()
        with BagReader(run / "bag") as bag:
            *_, last = bag.messages(["/fast/knob"])
        assert struct.unpack("<d", last.data[4:]) == (SAFE,)
    wait(lambda: not any(os.path.exists(f"/proc/{pid}") for pid in nodes.values()), "the nodes")


def rearm(probe, states, rig):
    """Rearm once the cause has gone, and wait until the controller commands again."""
    probe.spin_until(lambda: not states[-1].rearm_refused, "the cause to be gone")
    probe.spin_until(lambda: rig.theta == SAFE, "theta_safe")
    probe.spin_until(lambda: follows(probe, states, rig), "the controller to command again")


def test_whatever_fails_trips_the_guard_until_it_is_rearmed(up, fast_rig, probe, states, tmp_path):
    facts, node = tmp_path / "facts", probe.node
    process, nodes = up(on_alarm=alarm(facts, "echo no mail >&2; exit 3"))

    def check_trip(begin, end, *causes):
        """Let something fail, until the guard has tripped by it and not by a busy machine."""
        trip = None
        while trip is None or trip.cause not in causes:
            fault = begin()
            probe.spin_until(lambda: states[-1].status == GuardState.TRIPPED, "a trip")
            trip = states[-1]
            refused = probe.call(Trigger, "/koop_guard/rearm", Trigger.Request())
            assert (refused.success, "refused: " in refused.message) == (False, True)
            end(fault)
            rearm(probe, states, fast_rig)
        return trip

    def mend(fault):
        fast_rig.spike = fast_rig.silent = fast_rig.not_finite = False
        fast_rig.dead = None

    for fault, (cause, reason) in REASONS.items():
        trip = check_trip(lambda f=fault: FAULTS[f](fast_rig), mend, cause)
        assert reason in trip.reason
        assert trip.tripped_theta[0] < SAFE
    for topic, kind, cause in (
        ("/theta", ControlInput, "controller doubled"),
        ("/fast/knob", Float64, "another commander"),
        ("/fast", Float64MultiArray, "rig doubled"),
    ):
        publish = lambda t=topic, k=kind: node.create_publisher(k, t, 10)  # noqa: E731
        trip = check_trip(publish, node.destroy_publisher, cause)
        told = "which moves theta, too: stop that" in trip.reason
        assert told == (cause == "another commander")
    # on a busy machine the silence of a second is noticed before the look at the graph
    change = lambda transition: probe.change_state("/relay_esc", transition)  # noqa: E731
    check_trip(lambda: change("deactivate"), lambda _: change("activate"),
               "controller inactive", "controller silent")  # fmt: skip
    log = tmp_path / "run" / "logs" / "koop_guard.log"
    wait(lambda: "failed: exit code 3" in log.read_text(), "the alarm's end", process)
    assert "no mail" in log.read_text().partition("failed: exit code 3")[2]
    known = check_alarm(facts, "beyond its limit 8", fast_rig)
    assert (known["CAUSE"], known["X"].split()[0]) == ("channel beyond its limit", "99")
    trips = len(FAULTS) + 4
    wait(lambda: facts.read_text().count("NEXT") >= trips, "an alarm for each trip", process)
    process.send_signal(signal.SIGINT)
    check_end(process, nodes, fast_rig, tmp_path / "run", 0)
    assert " ends" not in facts.read_text()  # an orderly end is none
    with BagReader(tmp_path / "run" / "bag") as bag:
        counts = {topic.name: topic.count for topic in bag.topics}
    assert counts["/koop_guard/state"] >= 4 * trips
    assert counts["/fast/knob"] > 0
    # the figures are of what the rig was told; the controller itself asks for 0.9 at most
    theta = read(tmp_path / "run").signals.theta
    assert (theta == SAFE).any()


# at this dt a silence is of 4 s: a busy machine does not trip the guard
SLOWEST = {"measured": "state:x[0]", "command": "/knob:data", "theta_safe": 1.0, "dt": 0.2,
           "theta_start": 0.5}  # fmt: skip


def be_rig_and_controller(probe):
    """Return the rig's publisher, and what waits for a condition and is both meanwhile."""
    due, step = [0.0], itertools.count(1)
    kinds = {"state": MeasuredState, "theta": ControlInput}
    sources = [probe.node.create_publisher(kind, topic, 10) for topic, kind in kinds.items()]

    def until(condition, what, age=0.0):
        """Answer states of an age [s]."""

        def both():
            if time.monotonic() < due[0]:
                return condition()
            due[0] = time.monotonic() + SLOWEST["dt"]
            state, answer = MeasuredState(step=next(step), x=[random()]), ControlInput(theta=[0.8])
            now, answer.step = time.monotonic(), state.step
            for message, second in ((state, now), (answer, now - age)):
                message.header.stamp.sec = int(second)
                message.header.stamp.nanosec = int(second % 1.0 * 1e9)
            for source, message in zip(sources, (state, answer), strict=True):
                source.publish(message)
            return condition()

        probe.spin_until(both, what)

    return sources[0], until


def test_old_answers_trip_and_the_guard_rearms_itself_after_a_pause(start, probe, states):
    state, until = be_rig_and_controller(probe)
    resets = []
    probe.node.create_service(Trigger, "/probe/reset", lambda _, answer: resets.append(0) or answer)
    knob = probe.collect(Float64, "/knob")
    start("koop_guard", **SLOWEST, rearms=1)
    for rearmed in range(2):
        until(lambda: knob and knob[-1].data == 0.8, "the controller to be followed")
        state.publish(MeasuredState(step=2**64 - 1, x=[np.nan]))  # no run's, and unheard
        assert bool(resets) == bool(rearmed)  # twice where the cause came back meanwhile
        until(lambda: states[-1].status == GuardState.TRIPPED, "a trip", 5.0)
        assert states[-1].cause == "controller too old"
        assert states[-1].rearms_left == 1 - rearmed
        since = time.monotonic()
        until(lambda: not states[-1].rearm_refused, "the cause to be gone")
        assert knob[-1].data == 1.0
        if not rearmed:
            until(lambda: states[-1].status == GuardState.FOLLOWING, "an automatic rearm")
            # no sooner than 2.5 s without the cause and the pause of 10 s
            assert time.monotonic() - since >= 12.4
    assert probe.call(Trigger, "/koop_guard/rearm", Trigger.Request()).success


def test_a_lost_answer_delays_a_rearm_and_the_trip_is_over_for_good(start, probe, states, tmp_path):
    """Failed before: the guard waited for the answer, and an activation brought the trip back."""
    left, resets = tmp_path / "note", []
    trip = Trip(Cause.BEYOND, "x is beyond its limit", 0.0, (0.5,), ())
    note.leave(left, note.Note((0.5,), "/knob:data", (), trip, 0))
    _, until = be_rig_and_controller(probe)
    knob, controller = probe.collect(Float64, "/knob"), Executor()
    node = WithoutEvents("other", context=probe.context)
    reset = node.create_service(Trigger, "/probe/reset", lambda _, answer: answer)
    send = reset.send_response
    reset.send_response = lambda *answer: resets.append(0) or (len(resets) > 1 and send(*answer))
    controller.add_node(node)
    try:
        start("koop_guard", **SLOWEST, note=left)
        until(lambda: states and states[-1].status == GuardState.TRIPPED, "the trip")
        assert states[-1].reason == trip.reason
        until(lambda: not states[-1].rearm_refused, "theta_safe")
        assert probe.call(Trigger, "/koop_guard/rearm", Trigger.Request()).success
        until(lambda: controller.run(0.0) or states[-1].status == GuardState.FOLLOWING, "a rearm")
        assert len(resets) > 1
        until(lambda: knob[-1].data == 0.8, "the controller to be followed")
        for transition in ("deactivate", "activate"):
            assert probe.change_state("/koop_guard", transition)
        assert knob[-1].data == 1.0
        states.clear()
        until(lambda: knob[-1].data == 0.8, "the controller to be followed again")
        assert not any(state.status == GuardState.TRIPPED for state in states)
    finally:
        controller.shutdown()
        node.destroy_node()


def test_a_note_that_cannot_be_written_is_told_before_theta_is_commanded(start, probe, states):
    """Failed before: the log of the loop before said so, not that of the one that relies on it."""
    sealed = ctypes.CDLL(None).memfd_create(b"note", 2)  # that may be sealed: as read-only for root
    path, left = f"/proc/{os.getpid()}/fd/{sealed}", note.Note((0.5,), "/knob:data", (), None, 0)
    os.write(sealed, json.dumps(to_json(left)).encode())
    fcntl.fcntl(sealed, 1033, 8)  # F_ADD_SEALS, F_SEAL_WRITE
    _, until = be_rig_and_controller(probe)
    knob = probe.collect(Float64, "/knob")
    process = start("koop_guard", **SLOWEST, note=path)
    until(lambda: knob, "a command")
    assert f"{path}: " in (said := process.log.read_text())
    assert "theta was left at 0.5 or, if that was not noted, elsewhere" in said
    os.close(sealed)


def test_a_guard_that_was_stopped_and_went_on_does_not_blame_rig_or_controller(
    start, probe, states
):
    _, until = be_rig_and_controller(probe)
    knob = probe.collect(Float64, "/knob")
    guard = start("koop_guard", **SLOWEST)
    until(lambda: knob and knob[-1].data == 0.8, "the controller to be followed")
    os.kill(guard.process.pid, signal.SIGSTOP)
    begin = time.monotonic()
    until(lambda: time.monotonic() > begin + 6.0, "a while")
    os.kill(guard.process.pid, signal.SIGCONT)
    until(lambda: states[-1].status == GuardState.TRIPPED, "a trip")
    assert states[-1].cause == "guard stood still"
    assert re.fullmatch(r"the guard itself stood still for [67]\.\d s", states[-1].reason)
    until(lambda: not states[-1].rearm_refused, "the cause to be gone")
    assert {s.rearm_refused for s in states} <= {"", states[-1].reason, "the guard has not tripped"}


RIG_PROGRAM = """
import random, sys, time, rclpy
from std_msgs.msg import Float64, Float64MultiArray

rclpy.init()
node, heard = rclpy.create_node("rig"), open(sys.argv[1], "w", buffering=1)
node.create_subscription(
    Float64, "/rig/knob", lambda m: print(time.monotonic(), m.data, file=heard), 10
)
publisher = node.create_publisher(Float64MultiArray, "/rig", 10)
say = lambda: publisher.publish(Float64MultiArray(data=[random.random()]))
node.create_timer(0.05, say)
rclpy.spin(node)
"""


def test_a_rig_that_was_restarted_is_commanded_from_theta_start_within_the_rate(
    start, probe, states, tmp_path
):
    """Failed before: what returned to theta_safe without it was its first command, a step."""
    rigs, rate, begin, safe = [], 0.5, 0.4, 0.8
    controller = probe.node.create_publisher(ControlInput, "theta", 10)
    steps = itertools.count(1)

    def until(condition, what):
        def control():
            controller.publish(ControlInput(step=next(steps), theta=[0.6]))
            return condition()

        probe.spin_until(control, what)

    def start_rig():
        file = tmp_path / f"heard-{len(rigs)}"
        rigs.append(subprocess.Popen([sys.executable, "-c", RIG_PROGRAM, str(file)]))

        def heard():
            lines = file.read_text().splitlines() if file.exists() else []
            return [tuple(map(float, line.split())) for line in lines if line.count(" ") == 1]

        return heard

    try:
        heard = start_rig()
        guard = start("koop_guard", measured="/rig:data[0]", command="/rig/knob:data", dt=0.05,
                      theta_rate=rate, theta_start=begin, theta_safe=safe, theta_min=0.0,
                      theta_max=1.0, note=tmp_path / "note")  # fmt: skip
        until(lambda: heard() and heard()[-1][1] == 0.6, "the controller to be followed")
        for number in (signal.SIGKILL, signal.SIGINT):
            rigs[-1].send_signal(number)
            rigs[-1].wait()
            until(lambda: states[-1].cause == "rig silent" and states[-1].theta[0] == safe, "home")
            time.sleep(1.0)
            heard = start_rig()
            until(lambda: heard() and heard()[-1][1] == safe, "theta_safe again")  # noqa: B023
            # a step of the guard's may be heard early, the one before it late
            for (before, a), (now, b) in pairwise([(heard()[0][0], begin), *heard()]):
                assert 0.0 <= b - a <= rate * (now - before + 0.15)
        told = f"restarted since theta was at {safe}: assuming theta_start = {begin}"
        assert guard.log.read_text().count(told) == 2
        wait(lambda: len(note.read(tmp_path / "note").publishers) == 1, "the note")
        left = note.read(tmp_path / "note").publishers
        os.kill(guard.process.pid, signal.SIGKILL)  # its twin notes whose theta it is
        wait(lambda: "the guard was killed; " in guard.log.read_text(), "its end")
        assert set(left) <= set(note.read(tmp_path / "note").publishers)
    finally:
        for rig in rigs:
            rig.kill()


CLOCK = """
import rclpy, time
from rclpy.parameter import Parameter
from koop_guard.guard import Cause, Guard
from koop_guard.node.guard_node import GuardNode

rclpy.init()
values = {"command": "/knob:data", "rearms": 20}
node = GuardNode(parameter_overrides=[Parameter(name, value=v) for name, v in values.items()])
node.trigger_configure()
clock, text = time.time, []
time.time = lambda: clock() + 86400.0
node.run._guard.note(Cause.ASKED, "it was asked", time.monotonic())
for _ in range(2):
    print(node.run.diagnose()[1], flush=True)
    time.time = lambda: clock() - 86400.0
now = time.monotonic()
guard = node.run._guard = Guard(node.run._config, [0.0])
guard.note(Cause.INACTIVE, "it was inactive", now)
for wait in (0.0, 5.0):
    guard.hear_time(now + wait)
    print(node.run.diagnose()[1], flush=True)
"""


def test_a_trip_is_dated_by_the_clock_as_it_was_set_by_then():
    """Failed before: by that of the guard's start, on a machine without a clock of its own."""
    begin = time.time()
    done = subprocess.run([sys.executable, "-c", CLOCK], capture_output=True, text=True)
    told = re.findall("tripped: it was asked, at (.*?); rearm|$", done.stdout)[:2]
    at = time.mktime(time.strptime(told[0], "%Y-%m-%d %H:%M:%S")) - 86400.0
    assert begin - 1.0 <= at <= time.time(), done.stderr
    assert told[1] == told[0]
    ways = re.findall(
        "it was inactive, at [^;]*; it rearms itself (.*), 20 of 20 left", done.stdout
    )
    assert ways[0] == "10 s after its cause is gone"
    assert re.fullmatch(r"at \d\d:\d\d:\d\d", ways[1])


def assert_replays(koop, run):
    """Check that a run is repeated to the last bit, unless the guard has reset the controller.

    Or the recorder, for which a rig's loop does not wait, came after the first state.
    """
    with BagReader(run / "bag") as bag:
        status = read_columns(bag, "/koop_guard/state", ["status"])["status"].tolist()
        late = read_columns(bag, "/state", ["step"])["step"][0] > 1
    rearmed = (GuardState.TRIPPED, GuardState.FOLLOWING) in pairwise(status)  # a busy machine
    assert koop("replay", str(run)).wait(3.0 * LONG) == 0 or rearmed or late


def test_two_coupled_knobs_converge_resume_and_return_together(koop, probe, states, tmp_path):
    rig_file.write(TWO_KNOBS, tmp_path / "rig.yaml")
    (tmp_path / "loop.yaml").write_text(koop("params", "--rig", "rig.yaml").communicate()[0])
    values = changed(
        parameters.read(tmp_path / "loop.yaml", KNOWN),
        ("koopman_lifter", "cost", "raw"), ("koopman_lifter", "omega_h", 100.0),
        ("koopman_lifter", "omega_l", 20.0), ("relay_esc", "law", "adaptive"),
        ("relay_esc", "dwell", 0.5), ("relay_esc", "tau_f", 0.5),
        ("relay_esc", "step_size", [0.012, 0.0012]),
    )  # fmt: skip
    safe = TWO_KNOBS.theta_safe
    assert values["relay_esc"]["theta_initial"] == list(safe)
    parameter_file.write({k: v for k, v in values.items() if v}, tmp_path / "loop.yaml")
    rig = FastRig(two_knobs=True)

    def start(run, condition):
        count, process = len(rig.pairs), koop("up", "loop.yaml", "--out", run)

        def there():
            follows(probe, states, rig)
            return len(rig.pairs) > count + 50 and condition()

        wait(there, run, process, 2.0 * LONG)
        states.clear()
        return process

    try:
        process = start("first", lambda: rig.size < 0.6)  # at theta_safe it is 2.7
        status = koop("status").communicate()[0]
        assert re.search(r"theta = \[[-\d.]+, [-\d.]+\], guard (following|tripped)", status), status
        process.send_signal(signal.SIGINT)
        assert process.wait(LONG) == 0
        assert rig.pairs[-1] == safe
        begin = read_json(tmp_path / ".rig.yaml.controller")["begin"]
        of_knobs = {k: values["relay_esc"][k] for k in ("theta_initial", "step_size")}
        kept = EscConfig(**of_knobs, begin=begin).initial_directions().theta.tolist()
        process = start("again", lambda: rig.theta > 0.0 and rig.second < 0.2)
        rig.spike = True
        probe.spin_until(lambda: states and tuple(states[-1].theta) == safe, "theta_safe")
        assert states[-1].reason == REASONS["spike"][1]
        process.send_signal(signal.SIGINT)
        assert process.wait(LONG) == 0
        left = note.read(note.note_of(tmp_path / "rig.yaml"))
        assert left.trip.reason == REASONS["spike"][1]  # with which the next one begins
    finally:
        rig.close()
    # together, each within its rate: a command is up to 40 ms later than the other knob's
    way = np.array(safe) - states[-1].tripped_theta
    near = [np.allclose(pair, safe - way, atol=1e-3) for pair in rig.pairs]
    gone = 1.0 + (np.array(rig.pairs[len(near) - near[::-1].index(True) :]) - safe) / way
    late = np.array(TWO_KNOBS.theta_rate) * 0.04 / np.abs(way)
    # a busy machine loses some
    assert np.median(np.abs(gone[:, 0] - gone[:, 1])) <= late.max()
    assert (np.median(np.abs(np.diff(gone, axis=0)), axis=0) <= 2.0 * late).all()
    with BagReader(tmp_path / "again" / "bag") as bag:
        answers = read_columns(bag, "/theta", ["theta[0]", "theta[1]"])
    begin = [answers[f"theta[{i}]"][0] for i in (0, 1)]
    # on its way to the next point, it may have made a first step
    assert (np.abs(np.subtract(begin, kept)) <= np.array(TWO_KNOBS.theta_rate) * DT + 1e-12).all()
    assert kept != list(safe)
    assert_replays(koop, tmp_path / "again")


def test_theta_arrives_at_targets_and_no_step_is_answered_twice_by_a_controller_behind(
    start, probe, states
):
    # steps: more than a message may be overtaken by; at this dt a silence is of 4 s
    node, dt, behind = probe.node, 0.2, 200
    said = probe.collect(ControlInput, "/koop_guard/theta")
    state, asked = (node.create_publisher(*of, 10) for of in ((MeasuredState, "state"),
                                                              (ControlInput, "theta")))  # fmt: skip
    target = node.create_publisher(Float64MultiArray, "/koop_guard/target", KEPT)
    steps, aim, is_followed = itertools.count(1), [0.5], []
    start("koop_guard", measured="state:x[0]", command="/knob:data", theta_safe=1.0,
          theta_start=0.5, dt=dt)  # fmt: skip
    knob = probe.collect(Float64, "/knob")

    def until(condition, what):
        """Be rig and who sets a target, and then the controller, until it is so."""

        def publish():
            step = next(steps)
            state.publish(MeasuredState(step=step, x=[random()]))
            target.publish(Float64MultiArray(data=aim))
            if is_followed:
                asked.publish(ControlInput(step=step - behind, theta=[0.8]))
            return condition()

        probe.spin_until(publish, what)

    for theta in (0.5, 0.25, 0.4, 0.0, 0.4):
        aim[:] = [theta]
        there = lambda: states and (states[-1].status, states[-1].theta[0]) == (  # noqa: E731
            GuardState.FOLLOWING, theta)  # noqa: B023  # fmt: skip
        until(there, f"theta at {theta}")
        until(lambda: knob[-1].data == theta, f"the rig told of {theta}")  # noqa: B023
    until(lambda: said and said[-1].step > 2 * behind, "the guard's own answers")
    state.publish(MeasuredState(step=(last := next(steps)), x=[random()]))
    probe.spin_until(lambda: said[-1].step == last, "an answer to each state")
    aim.clear()
    is_followed.append(True)
    until(lambda: said[-1].step > last + behind and said[-1].theta[0] == 0.8, "the controller's")
    assert knob[-1].data == pytest.approx(0.8, abs=0.4)
    assert all(a.step < b.step for a, b in pairwise(said))


def test_an_orderly_end_may_hold_theta_and_a_guard_that_stops_may_not(up, fast_rig, tmp_path):
    """See also the ends of the other loops of this file."""
    facts = tmp_path / "facts"
    values = {"on_end": "hold", "note": str(tmp_path / "note"), "on_alarm": alarm(facts)}
    process, _ = up(**values)
    process.send_signal(signal.SIGINT)
    assert process.wait(LONG) == 0
    assert fast_rig.theta < 0.9
    assert not facts.exists() or " ends" not in facts.read_text()  # an orderly end is no alarm
    process, nodes = up("again", **values)  # goes on where theta was left
    os.kill(nodes["guard"], signal.SIGSTOP)
    check_end(process, nodes, fast_rig, tmp_path / "again", 2)
    check_alarm(facts, "the guard stood still for 8 s: its twin ended it", fast_rig)


def test_a_loop_that_tripped_is_still_tripped_after_a_restart(
    koop, up, fast_rig, probe, states, tmp_path
):
    process, nodes = up()
    for pid in nodes.values():  # a mailbox in shared memory may be lost with who is killed
        assert f"{FAST_DDS}_port" not in Path(f"/proc/{pid}/maps").read_text()
    fast_rig.spike = True
    home(fast_rig, process)
    fast_rig.spike = False
    os.kill(nodes["guard"], signal.SIGKILL)
    assert process.wait(LONG) == 2
    states.clear()
    process = koop("up", "loop.yaml", "--out", "again")
    probe.spin_until(lambda: states and not states[-1].rearm_refused, "the trip")
    assert (states[-1].status, states[-1].reason) == (GuardState.TRIPPED, REASONS["spike"][1])
    assert states[-1].tripped_at < time.time() - 1.0
    home(fast_rig, process)
    rearm(probe, states, fast_rig)
    process.send_signal(signal.SIGTERM)  # as systemd does
    assert process.wait(LONG) == 0
    left = note.read(str(note.note_of(tmp_path / "loop.yaml")))
    assert (left.theta, left.trip) == ((SAFE,), None)  # the next one does not begin tripped


def test_a_loop_goes_on_where_its_controller_was_killed(
    koop, up, fast_rig, probe, nodes_of, tmp_path
):
    """It is killed as a whole then."""
    facts = tmp_path / "facts"
    process, nodes = up(on_alarm=alarm(facts), rearms=9)  # a busy machine may be silent
    file, initial = tmp_path / ".loop.yaml.controller", LOOP["relay_esc"]["theta_initial"]
    dwell = Parameter("dwell", value=SLOWER_LOOP["relay_esc"]["dwell"] + 0.01).to_parameter_msg()
    request = SetParameters.Request(parameters=[dwell])
    assert probe.call(SetParameters, "/relay_esc/set_parameters", request).results[0].successful

    def has_moved():
        noted = read_json(file)
        return noted and noted["begin"][0] != initial and noted["changed"]["relay_esc"]

    wait(has_moved, "what the controller goes on from", process)
    os.kill(nodes["esc"], signal.SIGKILL)
    check_end(process, nodes, fast_rig, tmp_path / "run", 2)
    check_alarm(facts, "relay_esc was killed by signal 9|the controller is", fast_rig)
    theta, epsilon, *_ = read_json(file)["begin"]
    assert theta != initial
    facts.unlink()
    answers = probe.collect(ControlInput, "/theta")
    process = koop("up", "loop.yaml", "--out", "again")

    def seeks():
        probe.executor.spin_once(timeout_sec=0.05)
        return answers and not answers[-1].holding

    wait(seeks, "the controller to seek", process, LONG)
    request = GetParameters.Request(names=["dwell"])
    (value,) = probe.call(GetParameters, "/relay_esc/get_parameters", request).values
    assert value == dwell.value
    nodes = nodes_of(process)
    process.kill()
    check_end(process, nodes, fast_rig, tmp_path / "again", -signal.SIGKILL)
    check_alarm(facts, "the process that started the loop was killed|the controller is", fast_rig)
    with BagReader(tmp_path / "again" / "bag") as bag:  # the recorder was there before the answers
        first = read_columns(bag, "/theta", ["theta[0]", "epsilon"])
    assert (first["theta[0]"][0], first["epsilon"][0]) == (theta, epsilon)
    assert_replays(koop, tmp_path / "again")


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("", "theta is left at 1; theta_safe = 1"),
        ("0", "the rig's program has ended and hears no command: theta is as it left it"),
    ],
)
def test_a_rigs_program_hears_theta_return_before_it_is_ended(
    koop, own_domain, tmp_path, code, said
):
    heard, end = tmp_path / "heard", tmp_path / "end"
    words = [sys.executable, Path(__file__).with_name("rig_program.py"), heard, end]
    guard = {**LOOP["koop_guard"], "rearms": 5}  # it may be silent at first
    values = {**LOOP, "koop_guard": guard, "rig": {"command": shlex.join(map(str, words))}}
    file = tmp_path / "loop.yaml"
    parameter_file.write(values, file)
    file.write_text(file.read_text().replace("/**/", "/"))
    process = koop("up", file, "--out", "run")
    theta = lambda: float((heard.exists() and heard.read_text()) or "nan")  # noqa: E731
    wait(lambda: theta() < 0.7, "the controller to move theta", process, LONG)
    if code:
        (tmp_path / "part").write_text(code)
        (tmp_path / "part").rename(end)
    else:
        process.send_signal(signal.SIGINT)
    assert process.wait(LONG) == 0
    assert (theta() == SAFE) == (not code)
    assert said in process.stderr.read()
    lines = (tmp_path / "run" / "logs" / "koop_guard.log").read_text().splitlines()
    assert not [line for line in lines if "ERROR" in line and "the loop ends" in line]


def test_a_rig_that_listens_to_theta_itself_hears_the_guard_only(koop, nodes_of, probe, tmp_path):
    words = [sys.executable, installed("rigs") / "rig.py", "galloping", "--truth", "--until-eof"]
    rig = subprocess.Popen([*map(str, words), "--readers", "2"], stdin=subprocess.PIPE)
    try:
        guard = {
            "measured": "/state:x[0],x[1]", "command": "/theta:theta[0]", "theta_min": -5.0,
            "theta_max": 5.0, "theta_start": 2.0, "theta_safe": 2.5, "rearms": 9,
        }  # fmt: skip
        lifter = {"cost": "raw", "omega_h": 300.0, "omega_l": 30.0}  # settles in 0.1 s
        esc = {"step_size": 0.004, "theta_initial": 2.0, "rate_limit": 1.0, "dwell": 1.0,
               "tau_f": 1.0}  # fmt: skip
        values = {"koopman_lifter": lifter, "relay_esc": esc, "koop_guard": guard}
        file = tmp_path / "loop.yaml"
        parameter_file.write(values, file)
        file.write_text(file.read_text().replace("/**/", "/"))
        truths = probe.collect(PlantTruth, "/ground_truth")
        process = koop("up", file, "--out", "run")
        probe.spin_until(lambda: truths and truths[-1].theta_applied[0] < 1.8, "theta to move")
        assert probe.node.count_publishers("/theta") == 1
        os.kill(nodes_of(process)["guard"], signal.SIGKILL)
        probe.spin_until(lambda: truths[-1].theta_applied[0] == 2.5, "theta_safe")
        assert process.wait(LONG) == 2
        for a, b in pairwise(truths):
            # the rig's actuator follows by 1 per second, too: more than that it cannot show
            change, lost = abs(b.theta_applied[0] - a.theta_applied[0]), b.step - a.step - 1
            assert change <= 0.04 + 0.005 * lost + 1e-9
    finally:
        rig.stdin.close()
        rig.wait(LONG)


@pytest.fixture
def manager(tmp_path, monkeypatch):
    """Be the service manager: return whether the last it was told holds some words, and all."""
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.setblocking(False)
        said = []

        def says(words):
            with suppress(BlockingIOError):
                while True:
                    said.append((time.monotonic(), manager.recv(4096).decode()))
            return said and words in said[-1][1]

        yield says, said


def test_service_manager_any_terminal_and_the_page_are_told_how_the_loop_is(
    manager, up, fast_rig, koop, probe, states, tmp_path
):
    """The service manager is not told that it goes on if it does not; a terminal may end it.

    The page trips the guard, says why, and rearms it.
    """
    says, said = manager
    process, nodes = up(options=["--serve", "0"])

    def asked(*words):
        asking = koop("status", *words)
        text, error = asking.communicate(timeout=LONG)
        assert error == ""
        return asking.returncode, text

    def gone(seconds):
        """Return whether it was told nothing for some seconds."""
        return not says("nothing") and time.monotonic() - said[-1][0] > seconds

    wait(lambda: says("STATUS=healthy"), "a healthy loop", process, LONG)
    assert said[0][1].startswith("READY=1\nWATCHDOG=1\n")
    os.kill(nodes["lifter"], signal.SIGSTOP)
    wait(lambda: gone(3.0), "silence", process)  # the others report meanwhile
    wait(lambda: "koopman_lifter is silent" in asked("run")[1], "its reason", process, LONG)
    assert gone(3.0)
    os.kill(nodes["lifter"], signal.SIGCONT)
    wait(lambda: not gone(3.0), "a sign of life", process, LONG)
    probe.spin_until(lambda: states and states[-1].status == GuardState.TRIPPED, "the trip")
    rearm(probe, states, fast_rig)
    wait(lambda: says("STATUS=healthy"), "a healthy loop again", process, LONG)
    text = wait(lambda: (answer := asked(tmp_path / "run"))[0] == 0 and answer[1], "health")
    for words in (f"process {process.pid} of user {os.geteuid()}", "\n  healthy\n",
                  "guard following", "measured /fast:data[0],data[1], command /fast/knob:data",
                  f"run: {tmp_path}/run, recording, ", "running for 0:0"):  # fmt: skip
        assert words in text
    shown = float(re.search(r"theta = (\S+), guard", text)[1])
    assert any(abs(shown - theta) < 0.1 for _, theta in fast_rig.moved)
    assert asked("nowhere") == (3, "no loop runs of nowhere\n")
    log = tmp_path / "run" / "logs" / "view.log"
    address = wait(lambda: re.search(r"http://\S+token=\S+", log.read_text()), "the page", process)
    with Chromium(tmp_path, address[0]) as page:
        text = "document.querySelector('#guard-text')?.textContent ?? ''"
        ready = "document.querySelector('#ID').disabled === false"
        page.wait(f"{text} === 'Guard: following'")
        page.wait(ready.replace("ID", "trip"))
        page.value("document.querySelector('#trip').click()")
        page.wait(f"{text}.includes('tripped: ~/trip was called')")
        wait(lambda: says("tripped: ~/trip was called"), "the trip", process, LONG)
        home(fast_rig, process)
        page.wait(ready.replace("ID", "rearm"))
        page.value("document.querySelector('#rearm').click()")
        page.value("document.querySelector('#confirm-yes').click()")
        page.wait(f"{text} === 'Guard: following'")
        page.wait("document.querySelector('#acts').textContent.split('done').length === 3")
        wait(lambda: fast_rig.theta < 0.7, "the controller to command again", process)
        assert page.errors == []
    os.kill(nodes["recorder"], signal.SIGKILL)
    wait(lambda: says("recorder has ended"), "the recorder's end", process, LONG)
    assert probe.call(Trigger, "/koop_guard/trip", Trigger.Request()).success
    wait(lambda: says("tripped: ~/trip was called"), "the trip", process, LONG)
    code, text = asked("run")
    assert (code, "recorder has ended" in text) == (1, True)
    assert re.search(r"tripped: ~/trip was called, at 20\d\d-\d\d-\d\d \d\d:\d\d:\d\d", text)
    wait(lambda: "rearm it: koop status --rearm" in asked("run")[1], "theta_safe", process, LONG)
    code, text = asked("run", "--rearm")
    assert (code, "rearmed, the controller begins again" in text) == (0, True)
    wait(lambda: fast_rig.theta < 0.7, "the controller to command again", process)
    code, text = asked("loop.yaml", "--stop")
    assert (code, "ended: theta is left at 1; theta_safe = 1" in text) == (0, True)
    assert fast_rig.theta == SAFE
    assert process.wait(LONG) == 1  # as after Ctrl-C, without its recorder
    assert says("STOPPING=1")
    assert not any(os.path.exists(f"/proc/{pid}") for pid in nodes.values())


def test_a_twin_that_was_stopped_at_its_start_hangs(own_domain):
    twin = Twin()
    try:
        os.kill(twin.process.pid, signal.SIGSTOP)
        assert not twin.hangs(time.monotonic())
        assert twin.hangs(time.monotonic() + SAFETY.first)  # the guard then starts another one
    finally:
        twin.process.kill()
        twin.release([0.0])


def test_a_twin_that_cannot_be_replaced_at_once_is_later(start, probe, states):
    """Failed before: the guard ended, and left theta to nobody."""
    guard = start("koop_guard", measured="state:x[0]", command="/knob:data", dt=0.2)
    main = guard.process.pid

    def twin():
        pids = Path(f"/proc/{main}/task/{main}/children").read_text().split()
        return pids and int(pids[0])

    probe.collect(Float64, "/knob")
    state = probe.node.create_publisher(MeasuredState, "state", 10)
    probe.spin_until(lambda: state.publish(MeasuredState(x=[random()])) or states, "the guard")
    # by then it has the descriptors of its own entities
    assert not probe.call(Trigger, "/koop_guard/rearm", Trigger.Request()).success
    first, limit = twin(), resource.prlimit(main, resource.RLIMIT_NOFILE)
    resource.prlimit(main, resource.RLIMIT_NOFILE, (3, limit[1]))  # none is left
    os.kill(first, signal.SIGKILL)
    wait(lambda: "it cannot be started: " in guard.log.read_text(), "its error")
    assert guard.poll() is None
    resource.prlimit(main, resource.RLIMIT_NOFILE, limit)
    wait(lambda: twin() not in (first, []), "another twin")
