"""What happened while recording happens again: switches, holds, restarts, bad states."""

import math
import re
import signal
import time
from contextlib import contextmanager

import numpy as np
import pytest
from koop_msgs.msg import ControlInput, Cost, MeasuredState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParametersAtomically
from std_srvs.srv import SetBool

from koop_bag.bag.reader import BagReader
from koop_bag.bag.writer import BagWriter
from koop_bag.cdr.schema import load_schema
from koop_core.config import parameter_file
from koop_core.stream.arrival import timeout_of
from koop_core.stream.resend import Due, Resend
from koop_lab.cli.main import main
from koop_lab.replay.recording import read_recording
from koop_loop.training import TrainingConfig, train
from koop_node.node.dds_profile import TRANSPORTS
from koopman_lifter.config import shipped_model
from koopman_lifter.delays import Delays
from vdp_plant.config import PACING, PlantConfig

LISTENERS = "next recorder probe"  # on the cost
TIMEOUT = timeout_of(0.005)  # [s] of states and costs
PATIENCE = 1.0  # [s] without a theta, for a busy machine


class Rig:
    """A plant made of a list of states; waits for theta like a plant in lockstep.

    Like that, it sends a state again that gets no theta: the lifter may not know yet of the
    controller that the graph shows already, and its cost is then lost.
    """

    def __init__(self, probe):
        self.probe = probe
        self.resent = 0
        self.answers = probe.collect(ControlInput, "theta")
        self.costs = probe.collect(Cost, "cost")
        self.publisher = probe.node.create_publisher(MeasuredState, "state", 1000)
        probe.spin_until(
            lambda: self.publisher.get_subscription_count() == 2, "the lifter and the recorder"
        )

    def __call__(self, step, x):
        before = len(self.answers)
        self.send(step, x)
        question = Resend(PATIENCE, PACING.resends)
        question.ask(time.monotonic())

        def answered():
            if question.check(time.monotonic()) is Due.AGAIN:
                self.send(step, x)
            return any(answer.step == step for answer in self.answers[before:])

        self.probe.spin_until(answered, f"theta of step {step}")
        self.resent += question.resent

    def send(self, step, x=(1.0, 2.0)):
        self.publisher.publish(MeasuredState(step=step, x=[float(value) for value in x]))

    def swing(self, steps, size=1.0):
        for k in steps:
            self(k, (size * math.sin(0.3 * k), size * math.cos(0.3 * k) + 0.01 * k))

    def change_state(self, node, transition):
        assert self.probe.change_state(f"/{node}", transition)
        listening = 2 + (transition == "activate")
        self.probe.spin_until(
            lambda: self.probe.node.count_subscribers("cost") == listening, f"{node} on 'cost'"
        )

    def unanswered(self, steps, costs):
        """Send states that get no theta, but a cost each, or neither."""
        for k in steps:
            self.send(k, (math.sin(0.3 * k), math.cos(0.3 * k)))
        if costs:  # not by their number: a cost may be here later than the theta that it led to
            self.probe.spin_until(
                lambda: self.costs and self.costs[-1].step == steps[-1], "the last cost"
            )

    @contextmanager
    def stopped(self, process):
        """Stop a process until what it has not heard is older than its timeout."""
        process.process.send_signal(signal.SIGSTOP)
        yield
        last = time.monotonic()
        self.probe.spin_until(lambda: time.monotonic() > last + 1.1 * TIMEOUT, "it to be too old")
        process.process.send_signal(signal.SIGCONT)

    def set(self, node, name, value):
        kind = ParameterType.PARAMETER_STRING if isinstance(value, str) else 3
        field = {"string_value": value} if isinstance(value, str) else {"double_value": value}
        item = Parameter(name=name, value=ParameterValue(type=kind, **field))
        answer = self.probe.call(
            SetParametersAtomically,
            f"/{node}/set_parameters_atomically",
            SetParametersAtomically.Request(parameters=[item]),
        )
        return answer.result

    def hold(self, data):
        assert self.probe.call(SetBool, "/relay_esc/hold", SetBool.Request(data=data)).success


def wait_until_known(probe, folder):
    """What was changed before the recorder asked for the parameters is not known."""
    reference = folder / "parameters.yaml"
    wanted = {"/relay_esc:", "/koopman_lifter:"}
    probe.spin_until(
        lambda: reference.exists() and wanted <= set(reference.read_text().split()),
        "the recorder to know the parameters",
    )


@pytest.fixture(scope="module")
def without_shared_memory():
    """Let a node that is stopped hold no lock for which the others wait (decision 21)."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(TRANSPORTS, "UDPv4")
        yield


@pytest.fixture(scope="module")
def eventful_run(without_shared_memory, module_start, module_probe, tmp_path_factory):
    """Record everything that can happen; returns the folder and how often states were resent."""
    start, probe = module_start, module_probe
    folder = tmp_path_factory.mktemp("eventful") / "run"
    recorder = start("recorder", output=folder)
    controller = [
        start(
            "relay_esc",
            listeners="next recorder",
            dwell=0.05,
            step_size=0.01,
            rate_limit=1.5,
        ),
        start(
            "koopman_lifter",
            listeners=LISTENERS,
            omega_h=200.0,
            omega_l=30.0,  # settles in 23 states
        ),
    ]
    rig = Rig(probe)
    wait_until_known(probe, folder)
    rig.swing(range(40))
    rig(40, (math.nan, 1.0))
    rig(41, (1.0, 2.0, 3.0))
    rig(42, (1.0,))
    rig.swing(range(43, 60))
    rig.swing([59, 59])  # asked again
    rig.swing(range(70, 90))  # ten lost
    rig.send(85)  # overtaken
    rig.hold(True)
    rig.swing(range(90, 100))
    rig.hold(False)
    rig.swing(range(100, 130), 2.0)
    assert rig.set("koopman_lifter", "cost", "raw").successful
    rig.swing(range(130, 160), 2.0)
    assert rig.set("relay_esc", "dwell", 0.02).successful
    assert rig.set("koopman_lifter", "omega_l", 3.0).successful
    rig.swing(range(160, 200))
    rig.swing(range(900, 930))  # 3.5 s of silence
    rig.swing(range(60))  # the plant was started again
    _, lifter = controller
    rig.swing(range(60, 100))
    with rig.stopped(lifter):
        rig.unanswered(range(100, 110), costs=False)
    rig.swing(range(110, 130))
    recorder.process.send_signal(signal.SIGINT)
    assert recorder.process.wait(60.0) == 0
    assert [node.stop() for node in controller] == [0, 0]
    probe.node.destroy_publisher(rig.publisher)
    return folder, 2 + rig.resent


@pytest.fixture(scope="module")
def eventful(eventful_run):
    """Return the folder of that recording."""
    return eventful_run[0]


def test_an_eventful_run_is_replayed_bit_for_bit(eventful_run, capfd):
    folder, resent = eventful_run
    recording = read_recording(folder)
    assert np.ptp(recording.theta[recording.has_theta]) > 0.1
    assert recording.step[~recording.has_r].tolist() == [85]
    assert [(c.node, c.values, recording.step[c.index]) for c in recording.changes] == [
        ("koopman_lifter", {"cost": "raw"}, 130),
        ("relay_esc", {"dwell": 0.02}, 160),
        ("koopman_lifter", {"omega_l": 3.0}, 160),
    ]
    assert recording.step[recording.hold].tolist() == list(range(90, 100))
    code = main(["replay", str(folder)])
    printed, error = capfd.readouterr()
    assert code == 0, printed + error
    assert "r      identical bit for bit in all 340 steps" in printed
    assert "theta  identical bit for bit in all 340 steps" in printed
    assert "10 states without a recorded cost are left out" in printed
    assert f"{resent} states that were sent again are left out" in printed
    assert "from step 130 on, as recorded: koopman_lifter cost = raw" in printed


def test_another_model_is_replayed_and_who_was_inactive_is_not(start, probe, tmp_path, capfd):
    other = tmp_path / "other.npz"
    train(PlantConfig(), TrainingConfig(trajectories=5, duration=10.0)).save(other)
    folder = tmp_path / "run"
    recorder = start("recorder", output=folder)
    start(
        "relay_esc",
        listeners="next recorder",
        dwell=0.05,
        tau_f=0.02,
        step_size=0.01,
    )
    start("koopman_lifter", listeners=LISTENERS, omega_h=200.0, omega_l=30.0)
    rig = Rig(probe)
    wait_until_known(probe, folder)
    rig.swing(range(40))
    assert rig.set("koopman_lifter", "model", str(other)).successful
    rig.swing(range(40, 80))
    rig.change_state("relay_esc", "deactivate")
    rig.unanswered(range(80, 92), costs=True)
    rig.change_state("relay_esc", "activate")
    rig.swing(range(92, 120))
    recorder.process.send_signal(signal.SIGINT)
    assert recorder.process.wait(60.0) == 0
    code = main(["replay", str(folder)])
    printed, error = capfd.readouterr()
    assert code == 1, printed + error
    assert "from step 40 on, as recorded: koopman_lifter model =" in printed
    assert "r      identical bit for bit in all 120 steps" in printed
    assert "12 costs without a recorded theta are replayed as if the controller" in printed
    assert re.search(r"theta  differs in \d+ of 108 steps, first at step 92:", printed)
    assert "not in a bag, so not replayed: a restart, a reset or an inactive phase" in printed


def test_the_raw_cost_of_three_channels_needs_no_model_until_it_is_lifted(
    start, probe, tmp_path, capfd
):
    folder = tmp_path / "run"
    recorder = start("recorder", output=folder)
    esc = {"dwell": 0.05, "step_size": 0.01}
    start("relay_esc", listeners="next recorder", **esc)
    options = {"cost": "raw", "dt": 0.01, "model": "/nowhere.npz"}
    lifter = start("koopman_lifter", listeners=LISTENERS, **options)
    rig = Rig(probe)
    wait_until_known(probe, folder)
    x = [0.5 * k * math.sin(0.3 * k) * np.arange(1.0, 4.0) for k in range(60)]
    for k in range(60):
        rig(k, [1.0, 2.0] if k == 20 else x[k])
    probe.spin_until(lambda: rig.costs[-1].step == 59, "the last cost")
    energies = list({cost.step: cost.y_out for cost in rig.costs}.values())
    assert math.isnan(energies.pop(20))
    assert "state has 2 values, the first had 3" in lifter.log.read_text()
    wanted = [np.sqrt(np.mean(np.square(v))) for k, v in enumerate(x) if k != 20]
    assert energies == pytest.approx(wanted, rel=1e-12)
    assert {cost.model_id for cost in rig.costs} == {""}
    refused = rig.set("koopman_lifter", "cost", "lifted")
    assert (refused.successful, refused.reason) == (
        False, "/nowhere.npz: cannot be read: No such file or directory"
    )  # fmt: skip
    refused = rig.set("koopman_lifter", "model", str(shipped_model()))
    assert "trained at dt = 0.005 s, this node runs at dt = 0.01 s" in refused.reason
    rig(60, x[0])
    probe.spin_until(lambda: rig.costs[-1].step == 60, "the cost after the refusals")
    assert rig.costs[-1].source == Cost.RAW
    recorder.process.send_signal(signal.SIGINT)
    assert recorder.process.wait(60.0) == 0
    code = main(["replay", str(folder)])
    printed, error = capfd.readouterr()
    assert code == 0, printed + error
    assert "theta  identical bit for bit in all 61 steps" in printed


def test_a_run_with_delays_is_replayed_bit_for_bit_over_a_gap(start, probe, tmp_path, capfd):
    model = tmp_path / "delays.npz"
    config = TrainingConfig(trajectories=5, duration=10.0, degree=1)
    train(PlantConfig(), config, True, Delays(2, 4, 5)).save(model)
    folder = tmp_path / "run"
    recorder = start("recorder", output=folder)
    start("relay_esc", listeners="next recorder", dwell=0.05, step_size=0.01)
    options = {"omega_h": 200.0, "omega_l": 30.0, "model": model}
    start("koopman_lifter", listeners=LISTENERS, **options)
    rig = Rig(probe)
    wait_until_known(probe, folder)
    rig.swing(range(60))
    rig.swing(range(62, 99))  # two lost: interpolated
    rig(99, (math.nan, 1.0))
    rig.swing(range(100, 140))
    rig.swing(range(144, 170))  # four lost empty the delay line
    rig.swing(range(900, 960))  # so does a silence of 3.7 s
    recorder.process.send_signal(signal.SIGINT)
    assert recorder.process.wait(60.0) == 0
    recording = read_recording(folder)
    assert np.ptp(recording.theta[recording.has_theta]) > 0.1
    without = np.flatnonzero(np.isnan(recording.r))
    # the line fills, one sample is not finite wherever it is part of the state, the line fills
    filling = np.arange(15)
    expected = [*filling, *(97 + np.array([0, 5, 10, 15])), *(138 + filling), *(164 + filling)]
    assert without.tolist() == expected
    assert main(["replay", str(folder)]) == 0, capfd.readouterr()
    printed = capfd.readouterr().out
    assert "r      identical bit for bit in all 224 steps" in printed
    assert "theta  identical bit for bit in all 224 steps" in printed


@pytest.mark.parametrize("kept", [(), ("relay_esc",)])
def test_a_switch_whose_event_was_not_recorded_is_seen_in_the_costs(eventful, kept, tmp_path):
    """As in a bag of another recorder, or of one that knew the node a moment too late."""
    whole = read_recording(eventful)
    with BagReader(eventful) as bag, BagWriter(tmp_path / "bag") as writer:
        writer.custom_data.update(bag.custom_data())
        channels = {}
        for message in bag.messages():
            event = message.topic == "/parameter_events"
            if event and not any(name.encode() in message.data for name in kept):
                continue
            if message.topic not in channels:
                schema = load_schema(bag.topic(message.topic).type_name)
                channels[message.topic] = writer.add_topic(message.topic, schema)
            channel = channels[message.topic]
            writer.write(channel, message.log_time, message.publish_time, message.data)
    actual = read_recording(tmp_path / "bag")
    switches = [change for change in whole.changes if "cost" in change.values]
    assert [change for change in actual.changes if change.node == "koopman_lifter"] == switches


def test_an_eventful_run_has_metrics_and_a_plot(eventful, tmp_path, capfd):
    """Among its states are one of one value and one of three."""
    out = tmp_path / "run.png"
    assert main(["bag", "metrics", str(eventful), "--plot", str(out)]) == 0
    printed, error = capfd.readouterr()
    assert "x[1]" in printed, error
    assert "x[2]" not in printed
    assert out.is_file()


def test_what_the_user_sets_outlasts_a_recorded_change(eventful, tmp_path, capfd):
    file = tmp_path / "controller.yaml"
    parameter_file.write({"koopman_lifter": {"cost": "lifted"}}, file)
    assert main(["replay", str(eventful), "--params-file", str(file)]) == 1
    printed = capfd.readouterr().out
    assert "as recorded: koopman_lifter cost" not in printed
    assert "first at step 130" in printed
