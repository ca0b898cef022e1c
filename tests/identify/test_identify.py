"""Identification from bags, against systems whose operator is known."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.linalg import expm

from koop_identify.model.compare import costs
from koop_identify.model.from_bags import BagTraining, join_parts, load_bags, train_from_bags
from koop_identify.model.windows import period_of
from koop_identify.recording import counted
from koop_identify.recording.samples import Batch, recorded_source
from koop_identify.recording.segmentation import BagReading
from koop_identify.recording.segments import Segmentation, Segmenter
from koop_lab.cli.main import main
from koopman_lifter.model import load

DT = 0.02
A = np.array([[-0.1, 2.0], [-2.0, -0.1]])  # a damped oscillation, 2 rad/s
JOINTS = recorded_source("/joint_states:position[1],velocity[1]")
KNOB = recorded_source("/knob:data")
STORE = get_typestore(Stores.ROS2_JAZZY)


def oscillation(t, phase=0.0):
    """x(t) of x' = A x from [cos, sin] of the phase, shape (n, len(t))."""
    start = np.array([np.cos(phase), np.sin(phase)])
    return (expm(A * np.asarray(t)[:, None, None]) @ start).T


def write_numbers(writer, topic, times, values):
    """Add a topic of std_msgs/Float64."""
    kind = "std_msgs/msg/Float64"
    connection = writer.add_connection(topic, kind, typestore=STORE)
    for at, value in zip(times, values, strict=True):
        message = STORE.types[kind](data=float(value))
        writer.write(connection, int(at), STORE.serialize_cdr(message, kind))


def write_joints(path, t, x, theta=None, begin=1_700_000_000):
    """Write a bag of sensor_msgs/JointState with another library; the state is joint 1 of two.

    ``theta`` of every sample becomes a number on /knob where it changes, without a stamp.
    """
    types, plugin = STORE.types, StoragePlugin.MCAP
    header, stamp = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        kind = "sensor_msgs/msg/JointState"
        topic = writer.add_connection("/joint_states", kind, typestore=STORE)
        for time, (position, velocity) in zip(t, x.T, strict=True):
            at = round(time * 1e9)
            message = types[kind](
                header=header(stamp(begin + at // 10**9, at % 10**9), "rig"),
                name=["first", "second"],
                position=np.array([9.0, position]),
                velocity=np.array([9.0, velocity]),
                effort=np.array([]),
            )
            late = at + begin * 10**9 + 300_000
            writer.write(topic, late, STORE.serialize_cdr(message, kind))
        if theta is not None:
            turned = np.flatnonzero(np.diff(theta, prepend=np.nan) != 0.0)
            times = begin * 10**9 + np.round(t[turned] * 1e9).astype(np.int64)
            write_numbers(writer, "/knob", times, theta[turned])
    return path


def linear(paths, **options):
    reading = BagReading(JOINTS, dt=DT)
    return train_from_bags(paths, BagTraining(reading, **{"degree": 1, "modes": 3, **options}))


def test_an_oscillator_is_identified_from_unevenly_sampled_joint_states(tmp_path):
    rng = np.random.default_rng(1)
    paths = []
    for number in range(3):
        t = np.cumsum(rng.uniform(0.0005, 0.0015, 6000))  # 1 kHz with jitter
        paths.append(write_joints(tmp_path / f"bag{number}", t, oscillation(t, number)))
    model = linear(paths)
    # linear interpolation errs by h^2 |x''| / 8 < 2e-6 between samples 1.5 ms apart
    np.testing.assert_allclose(model.K[1:, 1:], expm(A * DT), atol=1e-4)
    np.testing.assert_allclose(model.K[1:, 0], 0.0, atol=1e-4)
    assert model.state_names == ("position1", "velocity1")
    assert [bag["name"] for bag in model.provenance["bags"]] == ["bag0", "bag1", "bag2"]
    assert len({bag["sha256"] for bag in model.provenance["bags"]}) == 3


def paused():
    """Return times and states of a recording in the middle of which the recorder slept."""
    t = np.arange(400) * DT
    t[200:] += 7.5 * DT
    x = oscillation(t)
    x[:, 200:] = oscillation(t[200:], 2.0)  # meanwhile somebody pushed the rig
    return t, x


def test_a_pause_is_not_bridged(tmp_path):
    model = linear([write_joints(tmp_path / "bag", *paused())])
    np.testing.assert_allclose(model.K[1:, 1:], expm(A * DT), atol=1e-9)
    assert model.provenance["pairs"] == 199 + 199
    assert model.provenance["bags"][0]["segments"] == 2


def test_dt_is_that_of_the_messages_where_nothing_else_tells_it(tmp_path):
    t = np.arange(1000) * DT + np.random.default_rng(2).uniform(0.0, 1e-4, 1000)
    bag = write_joints(tmp_path / "bag", t, oscillation(t))
    model = train_from_bags([bag], BagTraining(BagReading(JOINTS), degree=1, modes=3))
    assert model.dt == DT
    np.testing.assert_allclose(model.K[1:, 1:], expm(A * DT), atol=1e-3)


# -- without stamps -----------------------------------------------------------------------------


def received(t, rng, size=1.0):
    """Return when samples of times t [s] are received: late, at times in a batch, in order."""
    late = size * 0.2 * DT * rng.exponential(size=t.size)
    busy = rng.random(t.size) < 0.01 * size  # the host has something else to do, for up to 20 Dt
    busy[-100:] = False  # a recording that ends meanwhile has a gap there
    late[busy] += 20.0 * DT * rng.random(np.count_nonzero(busy))
    return np.maximum.accumulate(t + late + 1e-6 * np.arange(t.size))


def write_unstamped(path, at, x, begin=1_700_000_000):
    """Write a bag of std_msgs/Float64MultiArray, which bears no stamp."""
    types, kind = STORE.types, "std_msgs/msg/Float64MultiArray"
    layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topic = writer.add_connection("/adc", kind, typestore=STORE)
        for time, values in zip(at, x.T, strict=True):
            message = STORE.serialize_cdr(types[kind](layout=layout, data=values), kind)
            writer.write(topic, begin * 10**9 + round(time * 1e9), message)
    return path


def test_late_messages_without_stamps_are_no_gap_and_a_pause_is_one(tmp_path, capsys):
    rng = np.random.default_rng(4)
    t = np.arange(4000) * DT
    x = oscillation(0.2 * t)
    t[1500:] += 7.0 * DT  # nothing was sampled
    x[:, 1500:] = oscillation(0.2 * t[1500:], 2.0)
    at = received(t, rng)
    assert np.count_nonzero(np.diff(at) > 3.0 * DT) > 20  # what a gap by time would cut
    bag, out = write_unstamped(tmp_path / "bag", at, x), tmp_path / "model.npz"
    options = ["--measured", "/adc:data", "--dt", str(DT), "--degree", "1", "--modes", "2"]
    assert main(["train", str(bag), *options, "--out", str(out)]) == 0
    model = load(out)
    np.testing.assert_allclose(model.K[1:, 1:], expm(0.2 * A * DT), atol=1e-6)
    assert model.provenance["pairs"] == 4000 - 2
    printed = capsys.readouterr().out
    assert "4000 samples in 2 segments" in printed
    assert "no stamps: counted, one each 0.02 s; gaps longer than 0.06 s: 1" in printed


def test_samples_without_stamps_at_another_rate_are_interpolated_in_counted_time(tmp_path):
    t = np.arange(12_000) * DT / 4.0
    at = received(t, np.random.default_rng(5), size=0.25)
    path = write_unstamped(tmp_path / "bag", at, oscillation(t))
    reading = BagReading(recorded_source("/adc:data"), dt=DT)
    model = train_from_bags([path], BagTraining(reading, degree=1, modes=3))
    # jitter moves the period that is found by less than 1 %, the angle of A Dt likewise
    np.testing.assert_allclose(model.K[1:, 1:], expm(A * DT), atol=0.01 * 2.0 * DT)
    assert model.provenance["bags"][0]["segments"] == 1


@settings(deadline=None, max_examples=60)
@given(st.data())
def test_how_a_stream_is_batched_does_not_matter_to_the_count(data):
    size = data.draw(st.integers(2, 80))
    seed = data.draw(st.integers(0, 99))
    rng = np.random.default_rng(seed)
    lost = rng.random(size) < 0.05
    t = (np.cumsum(1.0 + 5.0 * lost) * DT * 1e9).astype(np.int64)
    t += (rng.exponential(size=size) * DT * 1e9).astype(np.int64)
    edges = [0, *sorted(data.draw(st.sets(st.integers(1, size - 1), max_size=6))), size]
    parts = [Batch(t[a:b], None, t[a:b, None] + 0.0, False) for a, b in pairwise(edges)]
    whole = [Batch(t, None, t[:, None] + 0.0, False)]
    times = [
        np.concatenate([part.time for part in counted.recount(fed, DT * 1e9, DT * 1e9, 5, 10)])
        for fed in (parts, whole)
    ]
    assert times[0].tolist() == times[1].tolist()


def test_a_clock_that_is_set_back_ends_a_segment():
    t = np.arange(100) * 10_000_000
    t[50:] -= 10**9
    (batch,) = counted.recount([Batch(t, None, t[:, None] + 0.0, False)], 1e7, 1e7)
    assert np.flatnonzero(np.diff(batch.time) != 10_000_000).tolist() == [49]
    assert np.diff(batch.time)[49] < 0


# -- segments -----------------------------------------------------------------------------------


def split(segmentation, time, step, x, bounds, apart):
    """Feed samples in batches; return all pairs of states so many steps apart."""
    segmenter = Segmenter(segmentation)
    edges = [0, *sorted(bounds), time.size]
    parts = [slice(a, b) for a, b in pairwise(edges)]
    fed = (Batch(time[p], step[p], x[p]) for p in parts)
    parts = list(join_parts((part for batch in fed for part in segmenter.split(batch)), apart))
    return [
        (*states[:, k - apart], *states[:, k])
        for states in parts
        for k in range(apart, states.shape[1])
    ]


@settings(deadline=None, max_examples=60)
@given(st.data())
def test_how_a_bag_is_read_in_batches_does_not_matter(data):
    size = data.draw(st.integers(5, 60))
    jumps = data.draw(st.lists(st.sampled_from([1, 1, 1, 1, 2, 9, 0, -5]), min_size=size,
                               max_size=size))  # fmt: skip
    step = np.cumsum(jumps)
    time = np.cumsum(np.array(jumps) * 10_000_000 + data.draw(st.integers(-3000, 3000)))
    x = np.arange(float(size))[:, None] ** [1, 2]
    x[data.draw(st.lists(st.integers(0, size - 1), max_size=2)), 0] = np.nan
    way = data.draw(st.sampled_from(["steps", "linear"]))
    segmentation = Segmentation(way, 0.007 if way == "linear" else 0.01, 0.035)
    bounds = data.draw(st.sets(st.integers(1, size - 1), max_size=6))
    for apart in (1, 3):
        whole = split(segmentation, time, step, x, set(), apart)
        assert split(segmentation, time, step, x, bounds, apart) == whole


def test_steps_pair_only_neighbours_of_the_same_run_and_share():
    step = np.array([0, 1, 2, 4, 5, 5, 6, 0, 1, 2])
    x = np.array([10.0, 11, 12, 14, 15, 15, np.nan, 20, 21, 22])[:, None]
    segmentation = Segmentation("steps", 0.01, 1.0)
    pairs = split(segmentation, step * 10_000_000, step, x, {3}, 1)
    assert pairs == [(10, 11), (11, 12), (14, 15), (20, 21), (21, 22)]
    assert split(segmentation, step * 10_000_000, step, x, {3}, 3) == []


# -- the command --------------------------------------------------------------------------------


def test_train_writes_a_model_that_inspect_explains(tmp_path, capsys):
    t = np.arange(1500) * DT
    bag, out = write_joints(tmp_path / "rig", t, oscillation(t)), tmp_path / "model.npz"
    options = ["--measured", str(JOINTS), "--degree", "1", "--modes", "2", "--out", str(out)]
    assert main(["train", str(bag), *options]) == 0
    model = load(out)
    assert (model.dt, model.state_names) == (DT, ("position1", "velocity1"))
    assert model.provenance["bags"][0]["states"] == 1500
    trained = capsys.readouterr().out
    assert main(["inspect", str(out)]) == 0
    inspected = capsys.readouterr().out
    assert inspected.split("\n", 1)[1].strip() in trained
    assert "rig (" in inspected
    assert "1500 samples in 1 segments" in inspected


def test_inspect_shows_the_residuals_of_a_noisy_bag(tmp_path, capsys):
    """Noise of 20 % shrinks the least-squares modulus by 1 + 0.2^2 / 0.5, and makes a residual."""
    rng = np.random.default_rng(6)
    t = np.arange(6000) * DT
    turn = np.stack((np.cos(2.0 * t), np.sin(2.0 * t)))
    bag = write_joints(tmp_path / "rig", t, turn + 0.2 * rng.standard_normal(turn.shape))
    out = tmp_path / "model.npz"
    options = ["--measured", str(JOINTS), "--degree", "1", "--modes", "3", "--out", str(out)]
    assert main(["train", str(bag), *options]) == 0
    model = load(out)
    modulus = abs(model.eigenvalues[np.argmax(model.eigenvalues.imag)])
    assert modulus == pytest.approx(1 / 1.08, abs=0.01)
    # of an eigenfunction that keeps its size
    np.testing.assert_allclose(model.residuals[1:], np.sqrt(1 - 1 / 1.08**2), atol=0.02)
    capsys.readouterr()
    assert main(["inspect", str(out)]) == 0
    shown = capsys.readouterr().out
    head, row = (line for line in shown.splitlines() if line.startswith(("eigenv", "1.000000 +")))
    assert head.split()[-2:] == ["residual", "selected"]
    assert row.split()[-1] == "Yes"
    assert main(["inspect"]) == 0
    assert "residuals are not known" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--dt", "0"], "dt = 0 s: must be positive"),
        (["--gap", "-1"], "gap = -1 s: must be positive"),
        (["--measured", "/joint_states"], "write /topic:field or"),
        (["--measured", "joint_states:position[0]"], "a bag knows topics by their full names"),
        (["--measured", "/joint_states:effort[0],effort[0]"], "names a field twice"),
        (["--measured", "/nowhere:x"], "has no topic /nowhere; it has /joint_states"),
        (["--measured", "/joint_states:speed"], "has no field 'speed'"),
        (["--delays", "0"], "0 delays: at least 1"),
        (["--dt", "0.02", "--measured", "/joint_states:position[7],position[1]"], "finite"),
    ],
)
def test_what_cannot_be_learned_is_said(tmp_path, options, message, capsys):
    t = np.arange(100) * DT
    bag = write_joints(tmp_path / "bag", t, oscillation(t))
    state = [] if "--measured" in options else ["--measured", str(JOINTS)]
    out = tmp_path / "model.npz"
    assert main(["train", str(bag), *state, *options, "--degree", "1", "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not out.exists()


PIECE = 2000  # samples of one strength


def test_the_contrast_of_a_bag_is_free_of_what_all_of_it_contains(tmp_path):
    t = DT * np.arange(20 * PIECE)
    swing = np.repeat([1.0, 5.0, 2.0, 6.0, 1.5] * 4, PIECE) * np.sin(2.0 * t)
    common = 20.0 * np.sin(3.1 * t)
    x = np.stack((common + swing + 4.0, 2.0 * common - swing + 1.0))
    path = write_joints(tmp_path / "bag", t, x)
    model = train_from_bags([path], BagTraining(BagReading(JOINTS, dt=DT), contrast=True))
    constant, *direction = model.projector[0, :3]
    # 2 x1 - x2 is free of the common part and has its centre at 2 * 4 - 1
    assert direction[0] / direction[1] == pytest.approx(-2.0, abs=0.02)
    assert constant / direction[1] == pytest.approx(7.0, abs=0.1)
    assert model.projector.shape[0] == 1
    assert model.provenance["variant"] == "contrast"
    assert model.provenance["strong_and_weak_by"] == "amplitude"


def write_swept(path, drift):
    """Write a rig that oscillates as theta is from 0, and an interference that comes and goes."""
    rng = np.random.default_rng(0)
    t = DT * np.arange(60 * PIECE)
    theta = np.repeat(rng.uniform(-2.0, 2.0, 60), PIECE)
    swing = (0.2 + np.abs(theta)) * np.sin(2.0 * t)
    interference = 20.0 * (1.2 + drift * np.sin(0.05 * t)) * np.sin(3.1 * t)
    x = np.stack((interference + swing, 2.0 * interference - swing))
    x += 0.01 * rng.standard_normal(x.shape)
    return write_joints(path, t, x, theta)


def test_theta_tells_the_oscillation_from_a_stronger_interference_that_comes_and_goes(tmp_path):
    """By amplitude alone, the interference's coming and going would be the contrast."""
    swept = write_swept(tmp_path / "bag", 1.0)
    ratio = {}
    for command in (None, KNOB):
        reading = BagReading(JOINTS, command, DT)
        model = train_from_bags([swept], BagTraining(reading, contrast=True))
        ratio[command] = model.projector[0, 1] / model.projector[0, 2]
    assert model.provenance["strong_and_weak_by"] == "theta"
    assert ratio[KNOB] == pytest.approx(-2.0, abs=0.01)
    assert abs(ratio[None] + 2.0) > 0.1


def test_what_is_learned_anew_of_a_candidate_is_what_was_judged(tmp_path):
    swept = write_swept(tmp_path / "bag", 0.0)
    loaded, reading = load_bags([swept], BagReading(JOINTS, KNOB, DT))
    period = 2.5 * period_of(loaded, DT)
    judged = {cost.name: cost for cost in costs(loaded, BagTraining(reading), period)}["contrast"]
    model = train_from_bags([swept], judged.training)
    assert model.provenance["window"] == judged.model.provenance["window"]
    assert model.projector == pytest.approx(judged.model.projector, rel=1e-6, abs=1e-9)


def test_one_channel_with_delays_tells_as_much_as_two(tmp_path):
    """A linear oscillator seen through one sensor, from a bag of std_msgs/Float64."""
    t = DT * np.arange(20 * PIECE)
    path = tmp_path / "bag"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        times = np.round((1.0 + t) * 1e9)
        write_numbers(writer, "/pressure", times, np.exp(-0.01 * t) * np.cos(3.0 * t))
    reading = BagReading(recorded_source("/pressure:data"), dt=DT)
    model = train_from_bags([path], BagTraining(reading, delays=2, degree=1))
    # two states are all that there is: three samples and products of them are told down from 3 to 1
    with pytest.raises(ValueError, match="take fewer delays"):
        train_from_bags([path], BagTraining(reading, delays=3))
    expected = np.exp((-0.01 + 3.0j) * DT)
    assert np.abs(model.eigenvalues - expected).min() < 1e-9
    # together they span an eighth of the period
    assert model.delays.every * DT == pytest.approx(0.125 * 2.0 * np.pi / 3.0, rel=0.1)
    # the modes of the oscillation are of the rig, not of the matrix
    assert model.residuals[np.argmin(np.abs(model.eigenvalues - expected))] < 1e-6


def test_a_bag_too_short_for_a_contrast_is_refused_with_what_to_do(tmp_path):
    t = DT * np.arange(1500)
    path = write_joints(tmp_path / "bag", t, oscillation(t))
    with pytest.raises(ValueError, match="record longer, while theta moves over its range"):
        linear([path], contrast=True)
