"""The long-term record of a real recorder, read by others and compared with numpy."""

import time
import warnings

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from koop_bag_messages import LOOP
from koop_bag_ros import Recorder, Talker, wait_until
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from koop_bag.bag.recover import recover
from koop_bag.bag.summary import Seconds
from koop_bag.cdr.schema import load_schema

pytestmark = pytest.mark.ros

GUARD = "/koop_guard/state"
TYPES = {**LOOP, GUARD: "koop_msgs/msg/GuardState"}
RING = ("-p", "keep_size:=100.0")


def read(bag):
    """Return time of reception and message of each topic, as rosbags reads them."""
    actual = {}
    with AnyReader([bag]) as reader:
        for connection, received, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            actual.setdefault(connection.topic, []).append((received, message))
    return actual


def publish_seconds(talker, seconds, begin=0):
    """Publish about as many seconds of a loop at 100 Hz, with a cost that is missing at times."""
    publishers = talker.publishers({topic: TYPES[topic] for topic in ("/state", "/cost", "/theta")})
    state, cost, theta = (publishers[topic] for topic in ("/state", "/cost", "/theta"))
    for k in range(begin, begin + 100 * seconds):
        x = [np.sin(0.1 * k), 3.0 + np.cos(0.37 * k)]
        state.publish(state.msg_type(step=k, x=x))
        r = float("nan") if k % 7 == 0 else 1e-3 * k
        model = "first" if k < 150 else "second"
        cost.publish(cost.msg_type(step=k, r=r, margin=0.5 - 0.002 * k, model_id=model))
        theta.publish(theta.msg_type(step=k, theta=[2.0 - 0.001 * k]))
        time.sleep(0.01)  # the pace of a rig, on which nothing here depends


def assert_equal_to_numpy(seconds, full):
    """Compare each second with the messages that were received in it."""
    columns = {
        "x": [(t, m.x) for t, m in full["/state"]],
        "r": [(t, [m.r]) for t, m in full["/cost"]],
        "margin": [(t, [m.margin]) for t, m in full["/cost"]],
        "theta": [(t, m.theta) for t, m in full["/theta"]],
    }
    for received, second in seconds:
        begin = second.header.stamp.sec * 10**9 + second.header.stamp.nanosec
        assert received == begin + 10**9
        for name, rows in columns.items():
            values = np.array([v for t, v in rows if begin <= t < begin + 10**9])
            for kind in ("min", "max", "mean"):
                with warnings.catch_warnings():  # the only cost of a second may be missing
                    warnings.simplefilter("ignore", RuntimeWarning)
                    expected = getattr(np, f"nan{kind}")(values, axis=0)
                actual = np.atleast_1d(getattr(second, f"{name}_{kind}"))
                np.testing.assert_allclose(actual, expected, rtol=2e-7, atol=1e-7)  # one float32
            if name == "x":
                assert second.count == len(values)
                np.testing.assert_allclose(second.x_std, values.std(axis=0), rtol=1e-6)


def test_seconds_are_what_numpy_makes_of_the_recording_and_no_message_is_in_none(tmp_path):
    with Recorder(tmp_path / "run", *RING) as recorder, Talker() as talker:
        publish_seconds(talker, 4)
        recorder.wait_for("/theta", 400)
        recorder.stop()
        assert recorder.process.returncode == 0, recorder.output()
    full, kept = read(tmp_path / "run" / "bag"), read(tmp_path / "run" / "summary")
    assert_equal_to_numpy(kept["/summary"], full)
    assert sum(second.count for _, second in kept["/summary"]) == 400
    models = [second.model_id for _, second in kept["/summary"]]
    assert models == sorted(models)
    assert set(models) == {"first", "second"}
    with open(tmp_path / "run" / "summary" / "summary_0.mcap", "rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        decoded = [m.theta_mean[0] for *_, m in reader.iter_decoded_messages(["/summary"])]
    assert decoded == pytest.approx([m.theta_mean[0] for _, m in kept["/summary"]])


def test_a_clock_that_is_set_back_goes_on_with_its_seconds(messages):
    """Before, all messages waited in memory until the clock had caught up."""
    seconds, schema = Seconds(), load_schema(TYPES["/state"])
    seconds.watch(1, "/state", schema.name, schema.text)
    actual = []
    for begin in (10_000, 6_400):
        for k in range(50):  # five seconds
            now = begin * 10**9 + k * 10**8
            seconds.add(1, now, messages.loop("/state", k))
            actual += [(s.begin // 10**9, s.count) for s in seconds.finish(now)]
    assert actual == [(begin + k, 10) for begin in (10_000, 6_400) for k in range(3)]


def test_a_recording_that_keeps_all_has_no_long_term_record(tmp_path):
    with Recorder(tmp_path / "run") as recorder, Talker() as talker:
        publish_seconds(talker, 1)
        recorder.wait_for("/theta", 100)
        recorder.stop()
    assert not (tmp_path / "run" / "summary").exists()


def test_the_guards_messages_and_changes_of_health_are_kept_as_they_came(tmp_path):
    with Recorder(tmp_path / "run", *RING) as recorder, Talker() as talker:
        publishers = talker.publishers({GUARD: TYPES[GUARD]})
        guard = publishers[GUARD]
        health = talker.node.create_publisher(DiagnosticArray, "/diagnostics", 100)
        for status, reason in ((1, ""), (2, "x[0] = 9 > 5"), (1, "")):
            guard.publish(guard.msg_type(status=status, reason=reason))
        levels = (b"\0", b"\0", b"\1", b"\1", b"\0")
        for count, level in enumerate(levels):
            status = DiagnosticStatus(name="a node", level=level, message=str(count))
            health.publish(DiagnosticArray(status=[status]))
        recorder.wait_for(GUARD, 3)
        talker.spin_until(lambda: health.get_subscription_count(), "the recorder to listen")
        recorder.wait_for("/diagnostics", len(levels))
        recorder.stop()
    full, kept = read(tmp_path / "run" / "bag"), read(tmp_path / "run" / "summary")
    assert [(t, m.reason) for t, m in kept[GUARD]] == [(t, m.reason) for t, m in full[GUARD]]
    own = [s.message for _, m in kept["/diagnostics"] for s in m.status if s.name == "a node"]
    assert own == ["0", "2", "4"]


def test_what_a_kill_takes_from_the_seconds_the_ring_still_has(tmp_path):
    with Recorder(tmp_path / "run", *RING) as recorder, Talker() as talker:
        publish_seconds(talker, 13)
        recorder.wait_for("/theta", 1300)

        def is_written():
            return (tmp_path / "run" / "summary" / "summary_0.mcap").stat().st_size > 2000

        wait_until(is_written, "the first ten seconds")
        recorder.process.kill()
        recorder.process.wait()
    for name in ("bag", "summary"):
        recover(tmp_path / "run" / name, tmp_path / name)
    full, kept = read(tmp_path / "bag"), read(tmp_path / "summary")
    assert_equal_to_numpy(kept["/summary"], full)
    last = full["/state"][-1][0]
    assert full["/state"][-1][1].step == 1299
    assert last - kept["/summary"][-1][0] < 12e9  # a chunk and the two seconds that gather
