"""Identification from bags, against systems whose operator is known."""

import struct

import numpy as np
import pytest
from mcap.writer import Writer as McapWriter
from rig_bags import (
    DT,
    JOINTS,
    A,
    oscillation,
    received,
    write_joints,
    write_numbers,
    write_unstamped,
)
from rosbags.rosbag2 import StoragePlugin, Writer
from scipy.linalg import expm

from koop_core.errors import InputError
from koop_identify.model.compare import costs
from koop_identify.model.from_bags import BagTraining, load_bags, train_from_bags
from koop_identify.model.windows import period_of
from koop_identify.recording.samples import recorded_source
from koop_identify.recording.segmentation import BagReading

COMMAND = recorded_source("/knob:data")
SEGMENT = 2000  # samples of one amplitude


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


def test_dt_is_that_of_many_messages_though_images_lie_between_them(tmp_path):
    """A bag is read by blocks of some MB; of those here each holds one sample."""
    times = 10**9 + 10**8 * np.arange(12)
    times[1] -= 5 * 10**7  # the first two are closer than usual
    with open(tmp_path / "a.mcap", "wb") as stream:
        writer = McapWriter(stream)
        writer.start("ros2")
        number = writer.register_schema("std_msgs/msg/Float64", "ros2msg", b"float64 data")
        pressure, camera = (
            writer.register_channel(name, "cdr", number) for name in ("/pressure", "/camera")
        )
        for k, time in enumerate(times.tolist()):
            writer.add_message(pressure, time, b"\0\1\0\0" + struct.pack("<d", k), time)
            writer.add_message(camera, time, bytes(9_000_000), time)
        writer.finish()
    reading = BagReading(recorded_source("/pressure:data"))
    loaded, known = load_bags([tmp_path / "a.mcap"], reading)
    assert known.dt == 0.1
    assert loaded.x[0, -1] == 11.0


@pytest.mark.parametrize("dt", [None, DT])
@pytest.mark.parametrize("clock", [np.floor, np.zeros_like], ids=["whole seconds", "stopped"])
def test_stamps_that_do_not_advance_are_refused(tmp_path, clock, dt):
    t = np.arange(400) * DT
    bag = write_joints(tmp_path / "bag", clock(t), oscillation(t))
    with pytest.raises(InputError, match="stamps of most messages on /joint_states do not adv"):
        train_from_bags([bag], BagTraining(BagReading(JOINTS, dt=dt), degree=1, modes=3))


def test_samples_without_stamps_at_another_rate_are_interpolated_in_counted_time(tmp_path):
    t = np.arange(12_000) * DT / 4.0
    at = received(t, np.random.default_rng(5), size=0.25)
    path = write_unstamped(tmp_path / "bag", at, oscillation(t))
    reading = BagReading(recorded_source("/adc:data"), dt=DT)
    model = train_from_bags([path], BagTraining(reading, degree=1, modes=3))
    # jitter moves the period that is found by less than 1 %, the angle of A Dt likewise
    np.testing.assert_allclose(model.K[1:, 1:], expm(A * DT), atol=0.01 * 2.0 * DT)
    assert model.provenance["bags"][0]["segments"] == 1


def test_the_contrast_of_a_bag_is_free_of_what_all_of_it_contains(tmp_path):
    t = DT * np.arange(20 * SEGMENT)
    swing = np.repeat([1.0, 5.0, 2.0, 6.0, 1.5] * 4, SEGMENT) * np.sin(2.0 * t)
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
    t = DT * np.arange(60 * SEGMENT)
    theta = np.repeat(rng.uniform(-2.0, 2.0, 60), SEGMENT)
    swing = (0.2 + np.abs(theta)) * np.sin(2.0 * t)
    interference = 20.0 * (1.2 + drift * np.sin(0.05 * t)) * np.sin(3.1 * t)
    x = np.stack((interference + swing, 2.0 * interference - swing))
    x += 0.01 * rng.standard_normal(x.shape)
    return write_joints(path, t, x, theta)


def test_theta_tells_the_oscillation_from_a_stronger_interference_that_comes_and_goes(tmp_path):
    """By amplitude alone, the interference's coming and going would be the contrast."""
    swept = write_swept(tmp_path / "bag", 1.0)
    ratio = {}
    for command in (None, COMMAND):
        reading = BagReading(JOINTS, (command,) if command else (), DT)
        model = train_from_bags([swept], BagTraining(reading, contrast=True))
        ratio[command] = model.projector[0, 1] / model.projector[0, 2]
    assert model.provenance["strong_and_weak_by"] == "theta"
    assert ratio[COMMAND] == pytest.approx(-2.0, abs=0.01)
    with pytest.raises(InputError, match="over one knob: name one of the fields"):
        train_from_bags([swept], BagTraining(BagReading(JOINTS, (JOINTS,), DT), contrast=True))
    assert abs(ratio[None] + 2.0) > 0.1


def test_what_is_learned_anew_of_a_candidate_is_what_was_judged(tmp_path):
    swept = write_swept(tmp_path / "bag", 0.0)
    loaded, reading = load_bags([swept], BagReading(JOINTS, (COMMAND,), DT))
    period = 2.5 * period_of(loaded, DT)
    judged = {cost.name: cost for cost in costs(loaded, BagTraining(reading), period)}["contrast"]
    model = train_from_bags([swept], judged.training)
    assert model.provenance["window"] == judged.model.provenance["window"]
    assert model.projector == pytest.approx(judged.model.projector, rel=1e-6, abs=1e-9)


def test_one_channel_with_delays_tells_as_much_as_two(tmp_path):
    """A linear oscillator seen through one sensor, from a bag of std_msgs/Float64."""
    t = DT * np.arange(20 * SEGMENT)
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
