"""The loop over DDS: equal to the offline loop to the last bit, recorded whole, ending cleanly."""

import math
import os
import re
import signal
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from koop_bag.bag.columns import read_columns
from koop_bag.bag.reader import BagReader
from koop_bringup.live.loop import LiveLoop
from koop_core.errors import LiveError
from koop_identify.recording.loop import LoopRecord, read_loop
from koop_lab.cli.main import main
from koop_lab.replay.answers import replay
from koop_lab.replay.plan import make_plan
from koop_lab.replay.recording import read_recording
from koop_loop.loop import simulate
from koop_loop.parameters import LoopParameters, make, read
from koop_loop.training import TrainingConfig, train
from koop_study.simulation.case import Case
from koop_study.simulation.run import run as run_case
from koopman_lifter.config import LifterConfig
from koopman_lifter.delays import Delays
from vdp_plant import dynamics
from vdp_plant.config import PlantConfig

pytestmark = pytest.mark.ros

LOCKSTEP = {"pace": "lockstep", "seed": 5, "theta_timeout": 20.0}
"""No state is sent again on a busy machine."""

CHANGED = {
    "koopman_lifter": {"cost": "raw"},
    "relay_esc": {"dwell": 1.0, "objective": "maximise"},
    "vdp_plant": {"mu": 1.2, "initial_state": [5.0, 1.0]},
}


LIMITED = {  # every limit and timeout away from its default; y_out_max, limits and rates act
    "koopman_lifter": {
        "cost": "raw", "y_out_max": 14.0, "omega_h": 30.0, "omega_l": 1.0,
    },
    "relay_esc": {
        "dwell": 0.5, "tau_f": 2.0, "step_size": 0.01, "theta_min": 1.95, "theta_max": 2.1,
        "rate_limit": 0.3,
    },
    "vdp_plant": {
        "theta_min": 1.98, "theta_max": 2.05, "theta_rate": 0.2, "theta_timeout": 20.0,
        "theta_safe_timeout": 30.0, "theta_safe": 1.9,
    },
}  # fmt: skip

ADAPTIVE = LIMITED | {
    "relay_esc": LIMITED["relay_esc"]
    | {"law": "adaptive", "theta_scale": "log", "step_ratio": 0.2, "widest": [1.5, 2.5]},
}


KNOBS = {  # two on a log scale, coupled, with a rate each; limits and a line between them are met
    "koopman_lifter": {"cost": "raw"},
    "relay_esc": {
        "law": "adaptive", "theta_scale": "log", "dwell": 0.2, "tau_f": 0.2,
        "step_size": [0.01, 0.02], "theta_min": [0.3, 0.9], "theta_max": 2.5,
        "theta_initial": [2.0, 1.0], "rate_limit": [1.5, 5.0],
        "constraint": "theta[0] <= 2.1 theta[1]",
    },
    "vdp_plant": {
        "theta_star": [0.5, 1.5], "theta_initial": [2.0, 1.0], "coupling": [0.8, 0.6, -0.3, 0.4],
        "theta_rate": [2.0, 3.0], "theta_max": [2.3, 2.4],
    },
}  # fmt: skip


@dataclass(frozen=True)
class Lockstep:
    """A run over DDS that was recorded."""

    folder: Path
    parameters: LoopParameters
    steps: int
    run: LoopRecord


def record(steps, changes, folder, composed):
    """Run over DDS for a number of steps; composed: the nodes in one process."""
    values = {"vdp_plant": LOCKSTEP | {"duration": steps * 0.005}}
    for node, options in changes.items():
        values[node] = values.get(node, {}) | options
    parameters = make(values)
    with LiveLoop(folder, parameters, composed=composed) as loop:
        loop.run(lambda progress: None)
    return Lockstep(folder, parameters, steps, read_loop(folder / "bag").closed(folder / "bag"))


@pytest.fixture(
    scope="module",
    params=[(10_000, {}, True), (2000, CHANGED, False)],
    ids=["composed", "processes"],
)
def lockstep(request, module_domain, tmp_path_factory):
    steps, changes, composed = request.param
    return record(steps, changes, tmp_path_factory.mktemp("lockstep"), composed)


def test_a_run_over_dds_is_the_offline_run_to_the_last_bit(lockstep):
    parameters, run = lockstep.parameters, lockstep.run
    model = parameters.load_model() if parameters.lifter.cost == "lifted" else None
    result = simulate(parameters.plant, parameters.lifter, parameters.esc, model, lockstep.steps)
    for name in ("step", "measured", "ground_truth", "r", "theta"):
        np.testing.assert_array_equal(getattr(run, name), getattr(result, name), name)
    assert run.lost == {"state": 0, "cost": 0, "theta": 0, "ground_truth": 0}
    assert np.ptp(run.theta) > 0.1  # the controller did act
    logs = "".join(log.read_text() for log in (lockstep.folder / "logs").iterdir())
    told = re.search(r"done: (\d+) steps, (\d+) of them compiled", logs)
    assert int(told[2]) < int(told[1]) == lockstep.steps
    wanted = os.environ.get("KOOP_COMPILED") != "0"
    assert (int(told[2]) > 0.1 * lockstep.steps) == wanted


@pytest.mark.parametrize(("composed", "pace"), [(True, "scaled"), (False, "realtime")])
def test_at_the_pace_of_a_timer_the_answers_replay_and_the_plant_integrates(
    module_domain, tmp_path, capfd, composed, pace
):
    timed = {"pace": pace, "time_scale": 2.0, "seed": 5, "duration": 8.0}
    parameters = make({"vdp_plant": timed, "koopman_lifter": {"cost": "raw"}})
    with LiveLoop(tmp_path, parameters, composed=composed) as loop:
        loop.run(lambda progress: None)
    with BagReader(tmp_path / "bag") as bag:
        truth = read_columns(bag, "/ground_truth", ["step", "x", "theta_applied", "theta_step"])
        state = read_columns(bag, "/state", ["step", "header.stamp"])
        theta = read_columns(bag, "/theta", ["step", "theta"])
    params, x = parameters.plant.params(), truth["x"]
    assert (truth["step"] == np.arange(1600)).all()
    assert (state["step"] == truth["step"]).all()
    for k in range(1599):
        after = dynamics.step.py_func(params, k, *x[k], truth["theta_applied"][k + 1][0])
        np.testing.assert_allclose(x[k + 1], after, rtol=1e-12)
    answered = truth["theta_step"][1:]  # the newest that had come acts
    assert (np.diff(answered) >= 0).all()
    assert (answered < truth["step"][1:]).all()
    given = dict(zip(theta["step"].tolist(), theta["theta"][:, 0].tolist(), strict=True))
    acted = [given.get(step, 2.0) for step in answered.tolist()]
    np.testing.assert_array_equal(truth["theta_applied"][1:, 0], acted)
    assert len(set(acted)) > 100  # the controller did act
    if pace == "realtime":  # else stamps are the plant's time
        period = np.median(np.diff(state["header.stamp"]))
        assert period == pytest.approx(5e6, rel=0.2)
    else:
        assert (state["header.stamp"] == np.arange(1600) * 5_000_000).all()
    told = re.search(
        r"done: 1600 steps, (\d+) of them compiled",
        "".join(log.read_text() for log in (tmp_path / "logs").iterdir()),
    )
    assert (int(told[1]) > 160) == (os.environ.get("KOOP_COMPILED") != "0")
    assert main(["replay", str(tmp_path)]) == 0
    assert "theta  identical bit for bit" in capfd.readouterr().out


def test_two_knobs_over_dds_offline_and_in_replay_are_equal_to_the_last_bit(
    module_domain, tmp_path, capfd
):
    lockstep = record(2000, KNOBS, tmp_path / "run", True)
    options, run = lockstep.parameters, lockstep.run
    offline = simulate(options.plant, options.lifter, options.esc, None, lockstep.steps)
    for name in ("measured", "ground_truth", "r", "theta"):
        np.testing.assert_array_equal(getattr(run, name), getattr(offline, name), name)
    assert run.theta.shape == (2000, 2)
    assert run.theta[:, 1].min() == 0.9  # at its limit
    assert 2.1 - 1e-6 < (run.theta[:, 0] / run.theta[:, 1]).max() <= 2.1  # and at the line
    assert (np.ptp(run.theta, axis=0) > 0.3).all()  # the controller did act
    changes = np.abs(np.diff(np.log(run.theta), axis=0))
    assert (changes.max(axis=0) <= np.array([1.5, 5.0]) * 0.005 * (1.0 + 1e-9)).all()
    assert main(["replay", str(lockstep.folder)]) == 0
    printed = capfd.readouterr().out
    for name in ("r      ", "theta[0] ", "theta[1] "):
        assert f"{name}identical bit for bit in all 2000 steps" in printed


def test_a_recorder_that_is_not_scheduled_holds_the_plant_and_lacks_nothing(
    module_domain, tmp_path
):
    parameters = make({"vdp_plant": LOCKSTEP | {"duration": 150.0}})
    stopped = gone_on = False
    observed: list[int] = []  # twenty a second, of which the plant reports one
    with LiveLoop(tmp_path, parameters, composed=True) as loop:
        recorder = loop.process_ids()["recorder"]

        def stall(progress):
            nonlocal stopped, gone_on
            if not stopped and sum(f.stat().st_size for f in tmp_path.rglob("*.mcap")) > 1_000_000:
                os.kill(recorder, signal.SIGSTOP)  # the run takes a second or two: not by reports
                stopped = True
            if stopped and not gone_on and progress.step:
                observed.append(progress.step)
                if len(observed) > 40 and len(set(observed[-40:])) == 1:  # the plant stands still
                    os.kill(recorder, signal.SIGCONT)
                    gone_on = True

        try:
            loop.run(stall)
        finally:
            with suppress(ProcessLookupError):  # it has ended with the run
                os.kill(recorder, signal.SIGCONT)
    assert gone_on
    assert observed[-1] < 30_000
    run = read_loop(tmp_path / "bag").closed(tmp_path / "bag")
    np.testing.assert_array_equal(run.step, np.arange(30_000))
    assert not any(run.lost.values())


@pytest.mark.parametrize("limits", [LIMITED, ADAPTIVE], ids=["relay", "adaptive"])
def test_with_every_limit_set_nodes_loop_study_and_replay_are_equal_to_the_last_bit(
    limits, module_domain, tmp_path
):
    lockstep = record(2000, limits, tmp_path, True)
    options, run = lockstep.parameters, lockstep.run
    offline = simulate(options.plant, options.lifter, options.esc, None, lockstep.steps)
    recording = read_recording(lockstep.folder)
    replayed = replay(recording, make_plan(recording))
    lifter = replace(options.lifter, cost=LifterConfig.cost)  # the study has a setting of its own
    case = Case("raw", lockstep.steps * 0.005, options.plant, lifter, options.esc)
    study = run_case(case)
    for r, theta in ((offline.r, offline.theta), replayed, (study.r, study.theta)):
        np.testing.assert_array_equal(run.r, r)
        np.testing.assert_array_equal(run.theta, theta)
    for truth in (offline.ground_truth, study.ground_truth):
        np.testing.assert_array_equal(run.ground_truth, truth)
    # what is compared did act
    unusable = np.flatnonzero(np.isnan(run.r))
    assert 100 < unusable.size < 1900
    np.testing.assert_array_equal(run.theta[unusable[1:]], run.theta[unusable[1:] - 1])
    assert (run.theta.min(), run.theta.max()) == (1.95, 2.1)
    u = np.array([options.esc.scaled(theta) for theta in run.theta])
    assert np.abs(np.diff(u)).max() == pytest.approx(0.3 * 0.005)
    other = replace(options.esc, law="adaptive" if options.esc.law == "relay" else "relay")
    assert not np.array_equal(
        simulate(options.plant, options.lifter, other, None, lockstep.steps).theta, run.theta
    )
    unlimited = replace(options.plant, theta_min=-100.0, theta_max=100.0, theta_rate=0.0)
    free = simulate(unlimited, options.lifter, options.esc, None, lockstep.steps)
    assert not np.array_equal(free.ground_truth, offline.ground_truth)


def test_with_delays_nodes_loop_and_replay_are_equal_to_the_last_bit(module_domain, tmp_path):
    """The state is the last samples: the delay line is part of what all of them share."""
    plant = PlantConfig(seed=5)
    training = TrainingConfig(trajectories=20, duration=20.0, degree=1)
    train(plant, training, True, Delays(2, 4, 22)).save(tmp_path / "model.npz")
    changes = {
        "koopman_lifter": {"model": str(tmp_path / "model.npz"), "omega_l": 1.0},
        "relay_esc": {"dwell": 0.5, "step_size": 0.01},
    }
    lockstep = record(2000, changes, tmp_path / "run", True)
    options, run = lockstep.parameters, lockstep.run
    offline = simulate(options.plant, options.lifter, options.esc, options.load_model(), 2000)
    recording = read_recording(tmp_path / "run")
    for r, theta in ((offline.r, offline.theta), replay(recording, make_plan(recording))):
        np.testing.assert_array_equal(run.r, r)
        np.testing.assert_array_equal(run.theta, theta)
    assert np.isnan(run.r[:66]).all()  # until the line is full
    assert np.isfinite(run.r[66:]).all()
    assert np.ptp(run.theta[:67]) == 0.0
    assert np.ptp(run.theta) > 0.1


def test_the_recorder_finds_out_what_the_nodes_were_given(lockstep):
    recorded, options = make(read(lockstep.folder / "parameters.yaml")), lockstep.parameters
    assert (recorded.plant, recorded.lifter, recorded.esc) == (
        options.plant,
        options.lifter,
        options.esc,
    )
    assert (lockstep.folder / "versions.yaml").is_file()


SHORT = pytest.mark.parametrize(
    "lockstep", [(2000, CHANGED, False)], ids=["processes"], indirect=True
)


@SHORT
def test_every_message_is_decoded_by_readers_that_no_one_here_wrote(lockstep):
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory
    from rosbags.highlevel import AnyReader

    run = lockstep.run
    with AnyReader([lockstep.folder / "bag"]) as reader:
        decoded = {}
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            decoded.setdefault(connection.topic, []).append(message)
    assert [m.step for m in decoded["/state"]] == list(range(lockstep.steps))
    np.testing.assert_array_equal([m.x for m in decoded["/state"]], run.measured)
    np.testing.assert_array_equal([m.r for m in decoded["/cost"]], run.r)
    np.testing.assert_array_equal([m.theta[0] for m in decoded["/theta"]], run.theta)
    np.testing.assert_array_equal([m.x for m in decoded["/ground_truth"]], run.ground_truth)
    (file,) = (lockstep.folder / "bag").glob("*.mcap")
    others = {}
    with file.open("rb") as stream:
        for _, channel, _, message in make_reader(
            stream, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            others.setdefault(channel.topic, []).append(message)
    assert {topic: len(m) for topic, m in others.items()} == {
        topic: len(m) for topic, m in decoded.items()
    }
    assert [m.theta[0] for m in others["/theta"]] == run.theta.tolist()


@SHORT
def test_simulated_time_is_stamped_and_the_truth_says_which_theta_acted(lockstep):
    from rosbags.highlevel import AnyReader

    parameters, run = lockstep.parameters, lockstep.run
    with AnyReader([lockstep.folder / "bag"]) as reader:
        of = {c.topic: c for c in reader.connections}
        ground_truth = [
            reader.deserialize(raw, of["/ground_truth"].msgtype)
            for _, _, raw in reader.messages([of["/ground_truth"]])
        ]
    for k, message in enumerate(ground_truth):
        stamp = message.header.stamp
        assert stamp.sec * 10**9 + stamp.nanosec == round(k * 0.005 * 1e9)
        applied = parameters.plant.theta_initial if k == 0 else run.theta[k - 1]
        assert message.theta_applied.tolist() == [applied]
        assert message.epsilon0 == pytest.approx(1.0 + math.sin(0.005 * k * 0.005), rel=1e-14)


@pytest.mark.parametrize(("composed", "who"), [(False, "koopman_lifter"), (True, "container")])
def test_a_node_that_fails_ends_the_run_with_its_own_words(tmp_path, composed, who):
    broken = tmp_path / "broken.npz"
    broken.write_bytes(b"PK")
    parameters = make({"vdp_plant": {"pace": "lockstep"}, "koopman_lifter": {"model": str(broken)}})
    with (
        LiveLoop(tmp_path / "run", parameters, composed=composed) as loop,
        pytest.raises(LiveError, match=rf"{who} ended with exit code 1:(.|\n)*broken.npz"),
    ):
        loop.run(lambda progress: None)
    assert all(process.poll() is not None for process in loop._nodes.values())
