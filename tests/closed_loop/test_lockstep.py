"""The loop over DDS: equal to the offline loop to the last bit, recorded whole, ending cleanly."""

import math

import numpy as np
import pytest

from koop_lab.errors import LiveError
from koop_lab.live.loop import LiveLoop
from koop_lab.recorded.run import read_run
from koop_loop.loop import simulate
from koop_loop.parameters import make, read


def lockstep(folder, steps, **changes):
    values = {"vdp_plant": {"pace": "lockstep", "duration": steps * 0.005, "seed": 5}}
    for node, given in changes.items():
        values[node] = values.get(node, {}) | given
    parameters = make(values)
    with LiveLoop(folder, parameters) as loop:
        loop.run(lambda progress: None)
    return parameters, read_run(folder / "bag")


def assert_identical(run, result):
    np.testing.assert_array_equal(run.step, result.step)
    np.testing.assert_array_equal(run.measured, result.measured)
    np.testing.assert_array_equal(run.ground_truth, result.ground_truth)
    np.testing.assert_array_equal(run.r, result.r)
    np.testing.assert_array_equal(run.theta, result.theta)


@pytest.mark.parametrize(
    ("steps", "changes"),
    [
        (20_000, {}),
        (
            2_000,
            {
                "koopman_lifter": {"cost": "raw"},
                "relay_esc": {"dwell": 1.0, "objective": "maximise"},
                "vdp_plant": {"integrator": "euler", "initial_state": [5.0, 1.0]},
            },
        ),
    ],
)
def test_a_run_over_dds_is_the_offline_run_to_the_last_bit(tmp_path, steps, changes):
    parameters, run = lockstep(tmp_path, steps, **changes)
    model = parameters.load_model() if parameters.lifter.cost == "lifted" else None
    result = simulate(parameters.plant, parameters.lifter, parameters.esc, model, steps)
    assert_identical(run, result)
    assert run.lost == {"state": 0, "cost": 0, "theta": 0, "ground_truth": 0}
    assert np.ptp(run.theta) > 0.1  # the controller did act
    # what the recorder found out about the nodes is what they were given
    recorded = make(read(tmp_path / "parameters.yaml"))
    assert (recorded.plant, recorded.lifter, recorded.esc) == (
        parameters.plant,
        parameters.lifter,
        parameters.esc,
    )
    assert (tmp_path / "versions.yaml").is_file()


def test_every_message_is_decoded_by_readers_that_no_one_here_wrote(tmp_path):
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory
    from rosbags.highlevel import AnyReader

    _, run = lockstep(tmp_path, 200)
    with AnyReader([tmp_path / "bag"]) as reader:
        decoded = {}
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            decoded.setdefault(connection.topic, []).append(message)
    assert [m.step for m in decoded["/state"]] == list(range(200))
    np.testing.assert_array_equal([m.x for m in decoded["/state"]], run.measured)
    np.testing.assert_array_equal([m.r for m in decoded["/cost"]], run.r)
    np.testing.assert_array_equal([m.theta for m in decoded["/theta"]], run.theta)
    np.testing.assert_array_equal([m.x for m in decoded["/ground_truth"]], run.ground_truth)
    (file,) = (tmp_path / "bag").glob("*.mcap")
    others = {}
    with file.open("rb") as stream:
        for _, channel, _, message in make_reader(
            stream, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            others.setdefault(channel.topic, []).append(message)
    assert {topic: len(m) for topic, m in others.items()} == {
        topic: len(m) for topic, m in decoded.items()
    }
    assert [m.theta for m in others["/theta"]] == run.theta.tolist()


def test_simulated_time_is_stamped_and_the_truth_says_which_theta_acted(tmp_path):
    from rosbags.highlevel import AnyReader

    parameters, run = lockstep(tmp_path, 300, relay_esc={"step_size": 0.01})
    with AnyReader([tmp_path / "bag"]) as reader:
        of = {c.topic: c for c in reader.connections}
        ground_truth = [
            reader.deserialize(raw, of["/ground_truth"].msgtype)
            for _, _, raw in reader.messages([of["/ground_truth"]])
        ]
    for k, message in enumerate(ground_truth):
        stamp = message.header.stamp
        assert stamp.sec * 10**9 + stamp.nanosec == round(k * 0.005 * 1e9)
        applied = parameters.plant.theta_initial if k == 0 else run.theta[k - 1]
        assert message.theta_applied == applied
        assert message.epsilon0 == pytest.approx(1.0 + math.sin(0.005 * k * 0.005), rel=1e-14)


def test_a_node_that_fails_ends_the_run_with_its_own_words(tmp_path):
    broken = tmp_path / "broken.npz"
    broken.write_bytes(b"PK")
    parameters = make({"vdp_plant": {"pace": "lockstep"}, "koopman_lifter": {"model": str(broken)}})
    with (
        LiveLoop(tmp_path / "run", parameters) as loop,
        pytest.raises(LiveError, match=r"koopman_lifter ended with exit code 1:(.|\n)*broken.npz"),
    ):
        loop.run(lambda progress: None)
    assert all(process.poll() is not None for process in loop._nodes.values())
