"""`koop train` and `koop inspect`, of systems whose operator is known."""

import numpy as np
import pytest
from rig_bags import DT, JOINTS, A, oscillation, received, write_joints, write_unstamped
from scipy.linalg import expm

from koop_lab.cli.main import main
from koopman_lifter.model import load


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
        (["--dt", "1e-5"], "dt = 1e-05 s, but a message on /joint_states comes every 0.02 s only"),
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
