"""The commands as a user types them."""

import json
import resource
import signal
import subprocess
import sys

import numpy as np
import pytest
import yaml

from koop_core.config import parameter_file
from koop_lab.cli.main import main
from koop_loop.loop import simulate
from koop_loop.parameters import make, read


def test_simulate_writes_metrics_and_a_plot(tmp_path, capsys):
    plot = tmp_path / "run"  # as it is named, whatever Matplotlib would add
    options = ["--duration", "150", "--plot", str(plot), "--json", "--seed", "3"]
    assert main(["simulate", *options]) == 0
    metrics = json.loads(capsys.readouterr().out)
    loop = make({"vdp_plant": {"seed": 3}})
    run = simulate(loop.plant, loop.lifter, loop.esc, loop.load_model(), 30_000)
    error = np.abs(run.theta[run.t >= 100.0] + 3.0)
    assert metrics["iae_theta"] == pytest.approx(error.sum() * 0.005, rel=1e-9)
    assert plot.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("duration", [200, 2500])
def test_the_papers_figures_stand_beside_those_of_a_run_of_its_length_only(duration, capsys):
    assert main(["simulate", "--duration", f"{duration}"]) == 0
    assert ("1445.3" in capsys.readouterr().out) == (duration == 2500)


def test_train_prints_the_mode_table_and_inspect_reads_the_file(tmp_path, capsys):
    path = tmp_path / "model.npz"
    options = ["--modes", "6", "--out", str(path)]
    assert main(["train", *options]) == 0
    printed = capsys.readouterr().out
    assert main(["inspect", str(path)]) == 0
    inspected = capsys.readouterr().out
    rows = [line for line in printed.splitlines() if line.endswith(("Yes", "No"))]
    assert len(rows) == 10
    assert all(row in inspected for row in rows)
    assert sum(row.endswith("Yes") for row in rows) in (6, 7)


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["simulate", "--model", "nowhere.npz"], "simulate: error: nowhere.npz: cannot be read"),
        (
            ["simulate", "--params-file", "nowhere.yaml"],
            "nowhere.yaml: cannot be read: No such",
        ),
        (
            ["simulate", "--duration", "1", "--plot", "/proc/x/y.png"],
            ": /proc/x/y.png: No such file",
        ),
        (["simulate", "--duration", "-1"], "duration = -1: must be 0 to 1e+09 s"),
        (["simulate", "--duration", "0"], "--duration must cover at least two steps"),
        (["simulate", "--duration", "1", "--plot", "x.xyz"], "'xyz' is not a format: choose png"),
        (["demo", "--duration", "0"], "--duration must cover at least two steps"),
        (["demo", "--model", "nowhere.npz"], "nowhere.npz: cannot be read"),
        (["demo", "--pace", "slow"], "must be realtime, lockstep or a number"),
        (["inspect", __file__], "truncated, damaged or not a model file"),
        (["train", "--degree", "0"], "degree = 0: must be 1 to 8"),
        (["train", "--delays", "8"], "--delays are for training on bags"),
        (["bag", "metrics", "nowhere"], "koop bag metrics: error: there is no bag nowhere"),
        (["check", "nowhere.yaml"], "no such file; koop commission --new nowhere.yaml writes one"),
    ],
)
def test_bad_input_ends_in_one_line_and_exit_code_2(argv, message, capsys):
    assert main(argv) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"koop {argv[0]}")
    assert message in error
    assert error.count("\n") == 1


def test_a_cost_that_comes_with_a_model_is_refused_with_the_way_to_it(capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["demo", "--cost", "contrast"])
    assert "koop train --contrast --out contrast.npz, then --model" in capsys.readouterr().err


def test_a_run_that_does_not_fit_into_memory_ends_in_one_line(capsys):
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (1 << 36, before[1]))  # the system may promise more
    try:
        assert main(["simulate", "--duration", "1e9"]) == 2
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
    error = capsys.readouterr().err
    assert error.startswith("koop simulate: error: Unable to allocate")
    assert len(error.splitlines()) == 1


def test_a_reader_that_has_seen_enough_is_no_error():
    command = [sys.executable, "-m", "koop_lab", "inspect"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 0


def test_ctrl_c_before_the_imports_are_done_is_no_traceback():
    command = [sys.executable, "-X", "importtime", "-m", "koop_lab", "inspect"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        for line in process.stderr:
            if "numpy._core" in line:  # imported by all that koop_lab is made of
                process.send_signal(signal.SIGINT)
                break
        rest = process.stderr.read()
    assert process.returncode == -signal.SIGINT
    assert "Traceback" not in rest


def test_a_parameter_file_is_read_as_ros_reads_it(tmp_path):
    file = tmp_path / "params.yaml"
    content = {
        "/**": {"ros__parameters": {"dt": 0.01, "use_sim_time": False, "omega_h": 5.0}},
        "/fleet/one/relay_esc": {"ros__parameters": {"dwell": 3}},
        "another_node": {"ros__parameters": {"anything": 1}},
    }
    file.write_text(yaml.safe_dump(content))
    parameters = make(read(file))
    assert (parameters.plant.dt, parameters.lifter.dt) == (0.01,) * 2
    assert parameters.lifter.omega_h == 5.0
    assert parameters.esc.dwell == 3.0


def test_written_parameters_are_read_back(tmp_path):
    parameters = make({"relay_esc": {"dwell": 3.0}, "vdp_plant": {"initial_state": [1, 2]}})
    parameter_file.write(parameters.as_ros(), tmp_path / "p.yaml")
    again = make(read(tmp_path / "p.yaml"))
    assert again.as_ros() == parameters.as_ros()
    assert again.plant.initial_state == (1.0, 2.0)


def test_the_contrast_model_serves_the_loop_and_beats_the_shipped_one(tmp_path, capsys):
    path = tmp_path / "contrast.npz"
    assert main(["train", "--contrast", "--out", str(path)]) == 0
    capsys.readouterr()
    drawn = tmp_path / "run.svg"
    options = ["--duration", "10", "--model", str(path), "--plot", str(drawn)]
    assert main(["simulate", *options]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("contrast cost ")
    assert f"written to {drawn}" in printed
    actual = []
    for model in ([], ["--model", str(path)]):
        assert main(["simulate", "--json", *model]) == 0
        actual.append(json.loads(capsys.readouterr().out))
    assert actual[1]["converged"]
    assert actual[1]["iae_theta"] < actual[0]["iae_theta"]


def test_both_packages_have_their_actions_under_koop_bag(capsys):
    with pytest.raises(SystemExit):
        main(["bag", "--help"])
    text = capsys.readouterr().out
    for action in ("info", "play", "recover", "metrics"):
        assert f"\n    {action} " in text
