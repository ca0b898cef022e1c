"""``koop excite``: whatever ends it, theta goes home, the recording is whole, and it resumes."""

import json
import os
import re
import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commission_rig import RIG, TYPES, FastRig
from koop_msgs.msg import MeasuredState
from std_msgs.msg import Float64
from waiting import TIMEOUT, wait

from koop_bag.bag.columns import read_columns
from koop_bag.bag.reader import BagReader
from koop_bringup.live.loop import LiveNodes
from koop_bringup.plan import Plan
from koop_commission.rig.guarded_theta import GUARD, guard_section
from koop_commission.rig.listener import Listener
from koop_commission.stages.excite import Excitation, read_holds
from koop_commission.stages.session import Session, refuse_incomplete_state, refuse_small_disk
from koop_core.config.parameter import ConfigError
from koop_core.errors import LiveError
from koop_guard.note import find_theta, note_of
from koop_node.client.client import Client
from koop_node.node.graph import identify_publishers
from koop_tune.excitation import progress
from koop_tune.rig import rig_file

pytestmark = pytest.mark.ros
RESUMED = 3  # times that a command may need on a busy machine
LATE = 0.4  # [s] that a command may come; a jump home would be twice as far as this allows
SLOW = replace(RIG, theta_rate=2.0)


def start_until(condition, koop, *words):
    """Start a command, and wait; again where a busy machine let the rig be silent for too long."""
    process = koop(*words)
    while not condition():
        if process.poll() is not None:
            error = process.communicate()[1]
            assert "to resume: " in error, error
            process = koop(*words)
        time.sleep(0.02)
    return process


def assert_walked(moved, rig):
    """The commands kept limits and rate, whatever became of who gave them."""
    times, theta = np.array(moved).T
    assert rig.theta_min <= theta.min()
    assert theta.max() <= rig.theta_max
    for i in range(0, theta.size, 10):  # the times are those of arrival on a busy machine
        ahead = slice(i, i + 200)
        allowed = rig.theta_rate * (times[ahead] - times[i] + LATE)
        assert (np.abs(theta[ahead] - theta[i]) <= allowed).all()
    assert theta[-1] == rig.theta_safe


def session_of(rig, client, nodes):
    source = rig.measured_source
    listener = Listener(client, source.topic, TYPES[0], source.fields)
    return Session(rig, client, listener, TYPES[1:], nodes)


def test_a_rig_that_fails_has_its_theta_taken_home(fast_rig, tmp_path):
    reason = r"data\[0\] = 99 is beyond its limit 8 at theta = -\S+: if .* narrow theta_min and"
    told = []
    nodes = LiveNodes(tmp_path, Plan({GUARD: guard_section(SLOW, None)}, rig=True))
    with Client("koop_test") as client, nodes:
        client.node.create_subscription(Float64, SLOW.command_sources[0].topic, told.append, 1000)
        session = session_of(SLOW, client, nodes)
        with session.command_theta():
            session.theta.go([-1.0])
            session.wait_until(lambda: fast_rig.theta < -0.8)
            fast_rig.spike = True
            with pytest.raises(LiveError, match=reason):
                client.wait_for(bool, TIMEOUT, "the fault", session.check)
        assert session.theta.value == (SLOW.theta_safe,)
    assert_walked(fast_rig.moved, SLOW)
    theta = [message.data for message in told]
    assert np.abs(np.diff(theta)).max() <= SLOW.theta_rate * LATE


def test_where_theta_may_be_elsewhere_the_reason_is_told_too(fast_rig, tmp_path):
    """Failed before: only that theta_safe was not seen in time."""
    nodes = LiveNodes(tmp_path, Plan({GUARD: guard_section(RIG, None)}, rig=True))

    def lose_guard_and_twin(session):
        with session.command_theta():
            session.go([-1.0])
            guard = nodes.process_ids()[GUARD]
            os.kill(guard, signal.SIGSTOP)
            for twin in Path(f"/proc/{guard}/task/{guard}/children").read_text().split():
                os.kill(int(twin), signal.SIGKILL)
            os.kill(guard, signal.SIGKILL)
            session.wait_until(lambda: False)

    with Client("koop_test") as client, nodes:
        session = session_of(RIG, client, nodes)
        reason = r"koop_guard was killed by signal 9\. theta may not be at theta_safe = 1: timed"
        with pytest.raises(LiveError, match=reason):
            lose_guard_and_twin(session)
    assert fast_rig.theta == -1.0


@pytest.mark.parametrize(
    ("pace", "last", "least", "most"),
    [(1e3, 5, 5 * RIG.dt, 5 * RIG.dt), (1.0, 10**9, 0.0, TIMEOUT)],
    ids=["slower than its pace", "a leap of its clock"],
)
def test_an_excitation_counts_the_time_of_the_rig(own_domain, tmp_path, pace, last, least, most):
    """Failed before: where a simulated rig fell behind its pace, the clock used up its time."""
    rig = replace(RIG, measured="/state:x[0],x[1]", pace=pace)
    with Client("koop_test") as client:
        publisher = client.node.create_publisher(MeasuredState, "/state", 10)
        listener = Listener(client, "/state", "koop_msgs/msg/MeasuredState", ((("step", None),),))
        session = Session(rig, client, listener, TYPES[1:], LiveNodes(tmp_path, Plan({}, rig=True)))
        excitation = Excitation(rig, tmp_path, progress.ExcitationProgress(), [], session)
        client.wait_for(lambda: publisher.get_subscription_count() == 1, TIMEOUT, "the listener")
        for step in (1, 2, last):  # the others are lost
            publisher.publish(MeasuredState(step=step))
        client.wait_for(lambda: listener.count == 3, TIMEOUT, "the messages")
        assert least <= excitation._elapsed <= most


def whole(bag):
    with BagReader(bag) as reader:
        assert reader.complete
        return read_columns(reader, "/theta", ["step", "theta[0]"]), {t.name for t in reader.topics}


def test_an_excitation_that_is_interrupted_or_loses_its_guard_goes_on(
    fast_rig, rig_yaml, koop, nodes_of, tmp_path
):
    done = tmp_path / "run" / "excite.json"

    def holds():
        return len(json.loads(done.read_text())["progress"]["holds"]) if done.exists() else 0

    first = start_until(lambda: holds() >= 2, koop, "excite", rig_yaml, "--out", "run")
    said, _ = koop("status", "run").communicate(timeout=TIMEOUT)
    (part,) = re.findall(r"commissioning in (run/part-\d): ", said)
    assert f"process {first.pid} of user {os.getuid()}" in said
    assert "theta = " in said
    said, _ = koop("status", "run", "--stop").communicate(timeout=TIMEOUT)
    assert f"theta_safe = {RIG.theta_safe:g}" in said
    out, error = first.communicate(timeout=TIMEOUT)
    assert first.returncode == 130, error
    assert re.search(
        "theta goes between -1 and 2, there and back, then to where it tells most about the best "
        r"value: at least \d+ s if what was heard is what it moves, at most \d+ s", out
    )  # fmt: skip
    assert 0 < out.count("(over the range)") <= holds()
    assert (
        f"theta is back at 1, or was not moved; to resume: ./koop excite {rig_yaml} --out run"
        in out
    )
    assert fast_rig.theta == RIG.theta_safe
    theta, topics = whole(tmp_path / part / "bag")
    assert {"/fast", "/fast/knob", "/state", "/cost", "/theta"} <= topics
    assert (np.diff(theta["step"].astype(int)) >= 0).all()  # said again while the nodes end
    assert theta["theta[0]"][-1] == RIG.theta_safe  # the way home is on record
    before = json.loads(done.read_text())["progress"]["holds"]
    another = lambda: holds() > len(before)  # noqa: E731
    second = start_until(another, koop, "excite", rig_yaml, "--out", "run")
    wait(lambda: fast_rig.theta != RIG.theta_safe, "theta to be elsewhere", second)
    os.kill(nodes_of(second)["guard"], signal.SIGKILL)
    out, error = second.communicate(timeout=TIMEOUT)
    (known,) = re.findall(r"(\d+) holds were done before", out)
    assert len(before) <= int(known) <= holds()
    assert second.returncode == 2
    assert error == (
        "koop excite: error: koop_guard was killed by signal 9. theta was returned to "
        f"theta_safe = 1; to resume: ./koop excite {rig_yaml} --out run\n"
    )
    wait(lambda: fast_rig.theta == RIG.theta_safe, "theta to come home")
    bag = max((tmp_path / "run").glob("part-*")) / "bag"
    wait(lambda: (bag / "metadata.yaml").exists(), "the bag to be closed")
    whole(bag)
    assert_walked(fast_rig.moved, RIG)
    # the next command goes on from there, but not if the rig was started again
    note, topic = note_of(rig_yaml), RIG.measured_source.topic
    with Client("looks") as client:
        wait(lambda: client.spin(0.1) or identify_publishers(client.node, topic), "the rig")
        first = identify_publishers(client.node, topic)
        wait(lambda: find_theta(note, RIG, first) == ((RIG.theta_safe,), ""), "the note")
        again = FastRig()
        try:
            other = lambda: client.spin(0.1) or identify_publishers(client.node, topic) - first  # noqa: E731
            theta, words = find_theta(note, RIG, wait(other, "the other rig"))
        finally:
            again.close()
    assert theta == (RIG.theta_start,)
    assert "was restarted since theta was left at 1" in words
    # the third would know all that the two had recorded
    state = progress.load(RIG, tmp_path / "run")
    theta = [hold.theta for hold in state.holds]
    assert theta[: len(before)] == [tuple(hold["theta"]) for hold in before]
    recorded = read_holds(RIG, tmp_path / "run", state)
    assert [RIG.theta_at(hold.u) for hold in recorded] == [
        pytest.approx(each, abs=0.01) for each in theta
    ]
    assert (np.diff([hold.elapsed for hold in recorded]) > 0.0).all()


def test_a_time_that_is_too_short_is_refused_before_theta_moves(fast_rig, koop, tmp_path):
    rig_file.write(replace(RIG, time=10.0), tmp_path / "short.yaml")
    for _ in range(RESUMED):
        out, error = koop("excite", "short.yaml", "--out", "run").communicate(timeout=TIMEOUT)
        if "silent" not in error and "no message" not in error:
            break
    assert "periods of 0.05 s; which of them react" in out
    assert re.search(r"of time = 10 in the rig file \d+ s are left: set time = \d+ in it", error)
    assert min(theta for _, theta in fast_rig.moved) == RIG.theta_safe  # on its way from 1.5


def test_what_cannot_be_recorded_is_refused_before_theta_moves(tmp_path):
    with pytest.raises(LiveError, match=r"MB are free, up to \d+ MB are needed: make room"):
        refuse_small_disk(RIG, tmp_path / "there", 1e12)
    state = replace(RIG, measured="state:x[0]", channel_max=())
    refuse_incomplete_state(state)
    with pytest.raises(ConfigError, match="the lifter takes all of"):
        refuse_incomplete_state(replace(state, measured="state:x[1]"))
