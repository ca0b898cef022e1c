"""Bags that lack something: other recorders, killed ones, other namespaces, a late start."""

import shutil
from itertools import islice
from pathlib import Path

import numpy as np
import yaml

from koop_bag.bag.reader import BagReader
from koop_bag.bag.writer import BagWriter
from koop_bag.cdr.schema import load_schema
from koop_lab.cli.main import main
from koop_loop.training import TrainingConfig, train
from koopman_lifter.config import shipped_model
from koopman_lifter.edmd import Gram
from koopman_lifter.model import build
from koopman_lifter.observables import Monomials
from vdp_plant.config import PlantConfig

RUN = Path(__file__).parents[2] / "recordings" / "golden" / "run"
LOOP = ("/state", "/cost", "/theta")


def copy(folder, topics=LOOP, begin=0, namespace="", parameters=None):
    """Write a bag with some of the golden bag's messages, those of a topic from one number on."""
    with BagReader(RUN) as bag, BagWriter(folder) as writer:
        if parameters:
            writer.custom_data["parameters"] = yaml.safe_dump(parameters)
        channels = {
            name: writer.add_topic(namespace + name, load_schema(bag.topic(name).type_name))
            for name in topics
        }
        counts = dict.fromkeys(topics, 0)
        for message in bag.messages(topics):
            counts[message.topic] += 1
            if counts[message.topic] > begin:
                writer.write(
                    channels[message.topic], message.log_time, message.publish_time, message.data
                )
    return folder


def golden_parameters(namespace=""):
    content = yaml.safe_load((RUN / "parameters.yaml").read_text())
    # the path is that of the machine that recorded; where no cost names the model, it is needed
    content["/koopman_lifter"]["ros__parameters"]["model"] = str(shipped_model())
    return {f"{namespace}{node}": content[node] for node in ("/koopman_lifter", "/relay_esc")}


def replay(folder, capsys, *options):
    code = main(["replay", str(folder), *map(str, options)])
    return code, "".join(capsys.readouterr())


def test_a_loop_in_a_namespace(tmp_path, capsys):
    bag = copy(tmp_path / "bag", namespace="/two", parameters=golden_parameters("/two"))
    code, printed = replay(bag, capsys)
    assert code == 2
    assert "no koop_msgs/msg/MeasuredState on /state: --namespace /two" in printed
    code, printed = replay(bag, capsys, "--namespace", "two")
    assert code == 0, printed
    assert "theta  identical bit for bit in all 2000 steps" in printed


def test_without_parameters_the_defaults_are_assumed_and_it_is_said(tmp_path, capsys):
    bag = copy(tmp_path / "bag")
    code, printed = replay(bag, capsys)
    assert code == 1
    assert "the bag contains no parameters" in printed
    assert "parameters and model are the recorded ones" not in printed
    assert "r      identical bit for bit" in printed
    code, printed = replay(bag, capsys, "--params-file", RUN.parent / "given.yaml")
    assert code == 0, printed


def test_a_node_that_was_gone_before_the_recorder_asked_it_is_named(tmp_path, capsys):
    parameters = golden_parameters()
    del parameters["/relay_esc"]
    code, printed = replay(copy(tmp_path / "bag", parameters=parameters), capsys)
    assert code == 1
    assert "the bag contains no parameters of relay_esc: the defaults" in printed
    assert "parameters and model are the recorded ones" not in printed


def test_states_alone_show_what_the_controller_would_answer(tmp_path, capsys):
    code, printed = replay(copy(tmp_path / "bag", topics=["/state"]), capsys)
    assert code == 0
    assert printed.count("nothing recorded to compare with") == 2


def test_why_a_recording_that_began_in_mid_run_differs_is_said(tmp_path, capsys):
    bag = copy(tmp_path / "bag", begin=700, parameters=golden_parameters())
    code, printed = replay(bag, capsys)
    assert code == 1
    assert "first at step 700" in printed
    assert "what the filters held before the recording began" in printed


def test_states_of_which_none_was_answered_are_refused(tmp_path, capsys):
    with BagReader(RUN) as bag, BagWriter(tmp_path / "bag") as writer:
        for name, numbers in {"/state": (0, 10), "/cost": (1990, 2000)}.items():
            channel = writer.add_topic(name, load_schema(bag.topic(name).type_name))
            for message in islice(bag.messages([name]), *numbers):
                writer.write(channel, message.log_time, message.publish_time, message.data)
    code, printed = replay(tmp_path, capsys)
    assert (code, printed.count("\n")) == (2, 1)
    assert "none of the 10 states has a recorded cost" in printed


def test_a_single_state_is_refused(tmp_path, capsys):
    bag = copy(tmp_path / "bag", topics=["/state"], begin=1999)
    assert main(["bag", "metrics", str(bag)]) == 2
    printed = "".join(capsys.readouterr())
    assert "no state follows on another" in printed
    assert printed.count("\n") == 1


def test_without_recorded_costs_every_state_is_replayed(tmp_path, capsys):
    bag = copy(tmp_path / "bag", topics=["/state", "/theta"], parameters=golden_parameters())
    code, printed = replay(bag, capsys)
    assert code == 0, printed
    assert "r      nothing recorded to compare with" in printed


def test_a_killed_recorder_s_bag_is_replayed_with_the_run_s_own_files(tmp_path, capsys):
    run = tmp_path / "run"
    shutil.copytree(RUN, run)
    (file,) = (run / "bag").glob("*.mcap")
    with open(file, "r+b") as torn:
        torn.truncate(file.stat().st_size // 2)
    (run / "bag" / "metadata.yaml").unlink()
    code, printed = replay(run, capsys)
    assert code == 0, printed
    assert "the bag contains no parameters" not in printed


def test_another_model_is_named(tmp_path, capsys):
    model = train(PlantConfig(), TrainingConfig(trajectories=5, duration=10.0))
    model.save(tmp_path / "other.npz")
    code, printed = replay(RUN, capsys, "--model", tmp_path / "other.npz")
    assert code == 1
    assert ["koopman_lifter.model", "6c06224ad266", model.model_id] in [
        line.split() for line in printed.splitlines()
    ]


def test_a_parameter_of_another_version_is_named_and_left_out(tmp_path, capsys):
    parameters = golden_parameters()
    parameters["/relay_esc"]["ros__parameters"]["newer"] = 1.0
    code, printed = replay(copy(tmp_path / "bag", parameters=parameters), capsys)
    assert code == 0, printed
    assert "relay_esc.newer = 1.0 was recorded; this version has no such parameter" in printed


def test_a_model_of_another_number_of_channels_is_refused(tmp_path, capsys):
    gram = Gram.empty(Monomials(1, 1))
    gram.add_trajectory(np.cos(0.1 * np.arange(100))[None])
    build(gram, 0.005, ("p",), 2, {}).save(tmp_path / "one.npz")
    code, printed = replay(RUN, capsys, "--model", tmp_path / "one.npz")
    assert code == 2
    assert "one.npz: trained on 1 channels, the state has 2" in printed
    file = tmp_path / "controller.yaml"
    file.write_text("koopman_lifter: {ros__parameters: {cost: raw}}")
    code, printed = replay(RUN, capsys, "--model", tmp_path / "one.npz", "--params-file", file)
    assert code == 1, printed  # which needs no model: another cost than the recorded one
