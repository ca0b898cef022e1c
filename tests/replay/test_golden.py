"""The golden bag: every version of the code answers its states with the same cost and theta."""

import re
from pathlib import Path

import numpy as np
import pytest

from koop_lab.cli.main import main
from koop_lab.replay.recording import read_recording

GOLDEN = Path(__file__).parents[2] / "recordings" / "golden"
RUN = GOLDEN / "run"


def test_the_golden_bag_is_small_and_shows_a_controller_at_work():
    assert sum(file.stat().st_size for file in GOLDEN.rglob("*") if file.is_file()) < 1_000_000
    recording = read_recording(RUN)
    np.testing.assert_array_equal(recording.step, np.arange(2000))
    moves = np.sign(np.diff(recording.theta))
    assert np.count_nonzero(np.diff(moves[moves != 0.0])) >= 5  # flips of the relay
    assert np.count_nonzero(recording.theta == -5.0) > 1  # at its limit
    assert recording.has_theta.all()


def test_the_golden_bag_is_replayed_bit_for_bit(capfd):
    code = main(["replay", str(RUN)])
    printed, error = capfd.readouterr()
    assert code == 0, error
    assert "r      identical bit for bit in all 2000 steps" in printed
    assert "theta  identical bit for bit in all 2000 steps" in printed


def parameters(folder, text):
    """Write a parameter file."""
    file = folder / "controller.yaml"
    file.write_text(text)
    return ["--params-file", str(file)]


def test_another_parameter_is_named_with_what_it_changes(tmp_path, capfd):
    # koop params writes 'listeners', too, which decides no answer
    options = parameters(tmp_path, "relay_esc: {ros__parameters: {dwell: 2.0, listeners: next}}")
    code = main(["replay", str(RUN), *options])
    printed, error = capfd.readouterr()
    assert code == 1, error
    assert "what the controller would have answered" in printed
    assert [
        line.split()
        for line in printed.splitlines()
        if line.startswith("relay_esc") and "this version has no such parameter" not in line
    ] == [["relay_esc.dwell", "1.0", "2.0"]]
    assert "r      identical bit for bit in all 2000 steps" in printed
    # the first flip, 1 s after the start, does not come
    assert re.search(r"theta  differs in \d+ of 2000 steps, first at step 200: recorded", printed)
    assert "parameters and model are the recorded ones" not in printed


def test_the_answers_to_another_cost_are_written(tmp_path):
    options = parameters(tmp_path, "koopman_lifter: {ros__parameters: {cost: raw}}")
    assert main(["replay", str(RUN), *options, "--out", str(tmp_path / "answers.npz")]) == 1
    with np.load(tmp_path / "answers.npz") as answers:
        for name in ("r", "theta"):
            assert (answers[name] != answers[f"recorded_{name}"]).any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("relay_esc: {ros__parameters: {dwel: 2}}", "parameter 'dwel': did you mean 'dwell'?"),
        ("relay_esc: {ros__parameters: {dwell: -1}}", "relay_esc: dwell = -1: must be 0 to 1e+08"),
        (["--model", "nowhere.npz"], "nowhere.npz: cannot be read"),
        (["--namespace", "/two"], "no koop_msgs/msg/MeasuredState on /two/state"),
    ],
)
def test_what_cannot_be_used_is_named(options, message, tmp_path, capsys):
    options = options if isinstance(options, list) else parameters(tmp_path, options)
    assert main(["replay", str(RUN), *options]) == 2
    assert message in capsys.readouterr().err
