"""States and theta of bags of any messages, written by another library."""

import json

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from koop_core.stream.arrival import Arrival
from koop_identify.recording.samples import recorded_source
from koop_identify.recording.segmentation import BagReading
from koop_identify.recording.signals import read_signals
from koop_lab.cli.main import main
from koop_lab.recorded.report import costs_of, read
from koopman_lifter import cost
from koopman_lifter.config import LifterConfig
from koopman_lifter.model import load

STORE = get_typestore(Stores.ROS2_JAZZY)
BEGIN = 1_700_000_000_000_000_000  # [ns] when the recorder started
JOINTS, PRESSURE = "/joint_states:position[0],velocity[0]", "/pressure:data"
DT = 0.01


def joint_state(t, x):
    """The rig's own clock began at 0."""
    types, at = STORE.types, round(t * 1e9)
    header = types["std_msgs/msg/Header"](
        types["builtin_interfaces/msg/Time"](at // 10**9, at % 10**9), "rig"
    )
    return types["sensor_msgs/msg/JointState"](
        header, ["one"], np.array([x[0]]), np.array([x[1]]), np.array([])
    )


def number(t, x):
    return STORE.types["std_msgs/msg/Float64"](float(x))


def write(path, **topics):
    """Write (make, kind, receive times, values) by topic name, in the order of reception."""
    messages = []
    for name, (make, kind, t, values) in topics.items():
        messages += [
            (round(at * 1e9), name, kind, make(at, v)) for at, v in zip(t, values, strict=True)
        ]
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        reference = {
            name: writer.add_connection(f"/{name}", kind, typestore=STORE)
            for name, (_, kind, _, _) in topics.items()
        }
        for at, name, kind, message in sorted(messages, key=lambda item: item[0]):
            writer.write(reference[name], BEGIN + at, STORE.serialize_cdr(message, kind))
    return path


def rig(t, before=2.0, after=0.5, until=40.0):
    """A swing of 1 Hz that dies down."""
    size = np.interp(t, [0.0, until], [before, after])
    return np.stack((size * np.sin(2 * np.pi * t), size * np.cos(2 * np.pi * t)), axis=1)


def falling(t):
    """Theta at rest for 10 s, then from 2 to -3 until 40 s, then a triangle of 0.5 and 8 s."""
    cycle = -3.0 + 0.5 * (4.0 * np.abs((t / 8.0) % 1.0 - 0.5) - 1.0)
    return np.where(t < 10.0, 2.0, np.where(t < 40.0, 2.0 - (t - 10.0) / 6.0, cycle))


@pytest.fixture(scope="module")
def joints(tmp_path_factory):
    """100 s of a JointState, stamped by a clock of its own, with a Float64 command at 10 Hz."""
    t, often = np.arange(10_000) * DT, np.arange(1000) * 0.1
    return write(
        tmp_path_factory.mktemp("joints") / "bag",
        joint_states=(joint_state, "sensor_msgs/msg/JointState", t, rig(t)),
        command=(number, "std_msgs/msg/Float64", often, falling(often)),
    )


@pytest.fixture(scope="module")
def pressure(tmp_path_factory):
    """100 s of a Float64 without stamps, received with jitter; theta told when it changes."""
    rng = np.random.default_rng(1)
    t = np.arange(10_000) * DT
    late, noise = t + rng.uniform(0.0, 0.004, t.size), 0.02 * rng.standard_normal(t.size)
    changes = np.arange(0.0, 100.0, 10.0)
    return write(
        tmp_path_factory.mktemp("pressure") / "bag",
        pressure=(number, "std_msgs/msg/Float64", late, rig(t)[:, 0] + noise),
        knob=(number, "std_msgs/msg/Float64", changes, np.arange(10.0)),
    )


def reading(measured, command=None, dt=DT):
    commands = (recorded_source(command),) if command else ()
    return BagReading(recorded_source(measured), commands, dt)


def test_theta_is_the_last_one_received_before_each_state(joints):
    signals = read_signals(joints, reading(JOINTS, "/command:data"))
    t = np.arange(10_000) * DT
    np.testing.assert_allclose(signals.t, t, atol=1e-6)
    np.testing.assert_allclose(signals.measured, rig(t), atol=1e-9)
    # a command and a state of the same time: either may come first
    expected = falling(np.floor((t + 1e-9) / 0.1) * 0.1)
    np.testing.assert_array_equal(signals.theta[t % 0.1 > 0.005], expected[t % 0.1 > 0.005])
    assert signals.begins.tolist() == [True] + [False] * 9999
    assert signals.names == ("position0", "velocity0")


def test_states_between_two_messages_have_the_theta_of_the_earlier(joints):
    signals = read_signals(joints, reading(JOINTS, "/command:data", dt=0.003))
    assert signals.way == "linear"
    before = np.floor(signals.t / DT + 1e-6).astype(int)  # number of the message
    options = falling(np.floor(before / 10 + 1e-6) * 0.1)  # none is interpolated
    np.testing.assert_array_equal(signals.theta, options)


def test_states_without_stamps_are_counted_and_theta_is_held_between_its_changes(pressure):
    signals = read_signals(pressure, reading(PRESSURE, "/knob:data"))
    np.testing.assert_allclose(np.diff(signals.t), DT, atol=1e-9)
    np.testing.assert_array_equal(signals.theta, np.repeat(np.arange(10.0), 1000))
    assert signals.covered == pytest.approx(100.0)


def test_a_theta_that_comes_often_and_stops_is_not_known_any_more(tmp_path, capsys):
    t, often = np.arange(10_000) * DT, np.arange(570) * 0.1
    bag = write(
        tmp_path / "bag",
        joint_states=(joint_state, "sensor_msgs/msg/JointState", t, rig(t)),
        command=(number, "std_msgs/msg/Float64", often, falling(often)),
    )
    options = ["--measured", JOINTS, "--command", "/command:data", "--dt", "0.01"]
    assert main(["bag", "metrics", str(bag), *options]) == 0
    printed = capsys.readouterr().out
    assert "the figures cover 57.91 of 100 s only" in printed  # and the second that it is held
    assert "it is there from 0 to 57.9 s" in printed
    assert "theta at the end: not recorded" in printed
    assert main(["bag", "metrics", str(bag), *options, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["coverage"]["covered"] == pytest.approx(57.9, abs=0.02)
    assert result["coverage"]["recorded"] == pytest.approx(100.0)
    assert not result["coverage"]["whole"]


def test_the_metrics_of_a_rig_need_no_optimum(joints, capsys):
    options = ["--measured", JOINTS, "--command", "/command:data"]
    assert main(["bag", "metrics", str(joints), *options, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    position = result["amplitude"]["channels"]["position0"]
    assert result["amplitude"]["before"] == pytest.approx({"from": 0.0, "to": 10.1}, abs=0.02)
    # two windows of 5 s; the amplitude falls from 2 by 0.0375 a second
    assert position["before"] == pytest.approx(2.0 - 5.0 * 0.0375, rel=0.02)
    assert position["after"] == pytest.approx(0.5, rel=0.02)  # a line takes a little of a sine
    assert result["theta"]["mean"] == pytest.approx(-3.0, abs=0.05)
    assert result["theta"]["swing"] == pytest.approx(1.0, abs=0.05)
    assert result["theta"]["settled_at"] == pytest.approx(36.4, abs=0.2)  # 2 - (t - 10) / 6 = -2.4
    assert (result["theta"]["at_limit"], result["dt"]) == (None, 0.01)  # of the messages
    assert "iae_theta" not in result
    assert main(["bag", "metrics", str(joints), *options]) == 0
    printed = capsys.readouterr().out
    assert "paper" not in printed
    assert "theta has settled: within its final swing from 36." in printed


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "no states of a loop on /state. For other messages name the fields: --measured"),
        (["--measured", "/joint:position[0]"], "has no topic /joint; it has "),
        (["--measured", JOINTS, "--dt", "0.01", "--command", "/knob:data"], "has no topic /knob"),
        (["--command", "/command:data"], "--command needs --measured"),
        (["--dt", "nan"], "--dt nan: must be positive"),
        (["--measured", "/joint_states:name[0]"], "field 'name[0]' holds text"),
        (["--measured", JOINTS, "--command", "/joint_states:header.frame_id"], "holds text"),
    ],
)
def test_what_cannot_be_read_is_named(joints, options, message, capsys):
    assert main(["bag", "metrics", str(joints), *options]) == 2
    assert message in capsys.readouterr().err


# -- costs --------------------------------------------------------------------------------------

TRAIN = ["--dt", "0.01", "--degree", "2", "--modes", "3", "--delays", "4"]


@pytest.fixture(scope="module")
def model(pressure, tmp_path_factory):
    """A model of one channel and four of its samples."""
    out = tmp_path_factory.mktemp("model") / "pressure.npz"
    options = ["--measured", PRESSURE, *TRAIN]
    assert main(["train", str(pressure), *options, "--out", str(out)]) == 0
    return out


def test_the_cost_of_any_states_under_a_model_is_that_of_the_node(pressure, model):
    """Beside it the same kernel, called state by state as the node calls it."""
    costs = costs_of(read(pressure, reading(PRESSURE), model=model), model)
    states = np.ascontiguousarray(read_signals(pressure, reading(PRESSURE)).measured)
    lifter, lifting = LifterConfig(dt=DT), load(model).lifting()
    detector, work, params = cost.initial(), cost.workspace(lifting), lifter.detector_params()
    r = np.empty(4000)
    for k in range(r.size):
        arrival = int(Arrival.NEXT if k else Arrival.JOIN)  # no step 0: it joins
        r[k], _, _, detector = cost.answer(
            lifter.source, lifting, params, detector, arrival, k + 1, states[k], work
        )
    np.testing.assert_array_equal(costs[f"r under {load(model).model_id}"][: r.size], r)
    assert np.isfinite(r).sum() > 2000


@pytest.mark.parametrize(
    ("dt", "measured", "message"),
    [
        (DT, JOINTS, "trained on 1 channels, the state has 2"),
        (0.02, JOINTS, "trained at dt = 0.01 s"),
    ],
)
def test_a_model_of_other_states_is_refused(joints, model, dt, measured, message, capsys):
    options = ["--measured", measured, "--dt", str(dt), "--model", str(model)]
    assert main(["bag", "metrics", str(joints), *options, "--plot", "x.png"]) == 2
    assert message in capsys.readouterr().err


# -- views --------------------------------------------------------------------------------------


def test_the_page_of_any_bag_is_drawn_under_a_model(pressure, model, tmp_path, capsys):
    out = tmp_path / "page.png"
    options = ["--measured", PRESSURE, "--command", "/knob:data", "--model", str(model)]
    assert main(["bag", "metrics", str(pressure), *options, "--plot", str(out)]) == 0
    assert out.read_bytes().startswith(b"\x89PNG")
    assert "the figures cover 100 of 100 s" in capsys.readouterr().out
