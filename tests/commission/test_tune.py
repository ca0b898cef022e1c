"""`koop tune`: what it chooses is tried on the rig itself, whose truths are known."""

from dataclasses import replace

import numpy as np
import pytest
from recorded_rig import (
    damped,
    excited,
    file_of,
    loaded_of,
    rig_of,
    write_bag,
)

from koop_guard.config import GUARD
from koop_lab.cli.main import main
from koop_loop import parameters
from koop_study.commissioning.excitation import training_of
from koop_study.family import oscillator
from koop_tune.result import tune_result
from koop_tune.rig import rig_file
from koop_tune.rig_model.surrogate import fit_times
from koop_tune.search.findings import NoOptimum, analyse
from koop_tune.search.settings import TuningSettings
from koop_tune.search.tuning import tune
from koopman_lifter.model import load

QUICK = {"amplitude_time": (2.0, 3.0), "depth": (6.0, 8.0), "noise": (0.01, 0.05),
         "optimum": (0.3, 0.7), "channels": (2, 2)}  # fmt: skip


def recorded(rig, **excitation):
    return loaded_of(*excited(rig, **excitation)), file_of(rig), training_of(rig)


@pytest.mark.parametrize(
    ("seed", "family", "cost"),
    [
        (3, {"clean": 1.0}, "raw"),
        (5, {"clean": 0.0, "interference": (6.0, 6.0), "common": 1.0}, "contrast"),
    ],
)
def test_the_tuned_loop_damps_the_rig_as_predicted(seed, family, cost):
    rig = rig_of(seed, **QUICK, **family, noise_driven=0.0, maps={"symmetric": 1.0})
    tuning = tune(*recorded(rig), settings=TuningSettings(effort=0.05))
    assert tuning.chosen.name.startswith(cost)
    best = tuning.findings.scale.theta_at(tuning.findings.static_map.best())
    assert abs(best - rig.best()[0]) < 0.1 * (rig.params.theta_max - rig.params.theta_min)
    predicted = tuning.prediction.excess
    assert 0.9 < predicted.low <= predicted.middle <= predicted.high < 1.5
    for end in (0, 1):
        got = damped(rig, tuning, seed=100 + end, end=end)
        assert got < 1.5
        # the amplitude of the recording holds noise, and its map has nine points
        assert predicted.low - 0.1 < got < predicted.high + 0.1


@pytest.mark.parametrize(
    ("name", "kind"), [("monotone", "monotone"), ("flat", "flat"), ("drowned", "flat")]
)
def test_a_rig_without_an_optimum_is_refused(name, kind):
    rig = rig_of(2, **QUICK, maps={name: 1.0}, clean=1.0, noise_driven=0.0)
    with pytest.raises(NoOptimum, match=r"record|leave theta there") as no:
        analyse(*recorded(rig))
    assert no.value.kind == kind
    if name == "monotone":
        worst = rig.best()[0] > 0.5 * (rig.params.theta_min + rig.params.theta_max)
        assert f"theta_{'max' if worst else 'min'}" in str(no.value)


def test_modes_that_trade_off_are_told_with_what_each_has_over_its_own_best():
    rig = rig_of(3, **QUICK, maps={"two-modes": 1.0}, clean=1.0, noise_driven=0.0)
    findings = analyse(*recorded(rig))
    u = np.clip(findings.static_map.u, 0.0, 1.0)
    levels = np.array([oscillator.two_modes(rig.params, v, 0.0) for v in u])
    over = levels[np.argmin(np.abs(u - findings.static_map.best()))] / levels.min(axis=0)
    own = findings.scale.theta(u[levels.argmin(axis=0)])
    f = findings.dwells.amplitude.windows.frequency
    slow, fast = ([m for m in findings.modes if (f[m.first] < 1.5 * rig.frequency) == slower]
                  for slower in (True, False))  # fmt: skip
    assert [mode.theta for mode in slow] == pytest.approx([own[0]] * len(slow))
    assert max(mode.worse for mode in slow) == pytest.approx(over[0], rel=0.05)
    # of the other one the background hides how little it has at its best
    assert [mode.theta for mode in fast] != pytest.approx([own[0]] * len(fast))
    assert 1.5 < max(mode.worse for mode in fast) < over[1]


def test_the_time_constant_is_that_of_the_rig():
    rig = rig_of(4, **{**QUICK, "amplitude_time": (20.0, 20.0)}, clean=1.0, noise_driven=0.0)
    loaded, file, training = recorded(rig, stay=5.0)
    findings = analyse(loaded, file, training)
    times = fit_times(loaded, findings.dwells, findings.static_map, findings.scale, file.dt)
    tau = [times.tau(float(a), up) for a in findings.static_map.mean for up in (True, False)]
    # d a^2/dt = a^2 (1 - a^2 / L^2) / tau: near L the amplitude's own time is tau
    assert 0.4 * rig.slowest < np.median(tau) < 2.0 * rig.slowest


def test_an_optimum_in_doubt_is_tuned_for_and_said():
    """Below the optimum little gets worse, less than the errors; above it much does."""
    rig = rig_of(3, **{**QUICK, "optimum": (0.85, 0.85)}, clean=1.0, noise_driven=0.0,
                 maps={"one-sided": 1.0}, quiet=0.0)  # fmt: skip
    loaded, file, training = recorded(rig)
    noisy = loaded.x + np.random.default_rng(0).normal(0.0, 3.5 * loaded.x.std(), loaded.x.shape)
    findings = analyse(replace(loaded, x=noisy), file, training)
    assert "towards theta_min is not certain" in findings.doubt
    assert any(judged.usable for judged in findings.costs)


@pytest.fixture(scope="module")
def bagged(tmp_path_factory):
    """Record a rig that needs a model, and its rig file."""
    folder = tmp_path_factory.mktemp("bagged")
    rig = rig_of(5, **QUICK, clean=0.0, interference=(6.0, 6.0), common=1.0, noise_driven=0.0,
                 maps={"symmetric": 1.0})  # fmt: skip
    write_bag(folder / "bag", rig, *excited(rig))
    rig_file.write(file_of(rig), folder / "rig.yaml")
    return folder, rig


def test_a_bag_becomes_a_controller_with_its_reasons(bagged, capsys):
    folder, rig = bagged
    words = ["tune", str(folder / "rig.yaml"), str(folder / "bag"),
             "--out", str(folder / "out"), "--effort", "0.1"]  # fmt: skip
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "predicted" in said
    assert "koop up" in said
    loop = parameters.make(parameters.read(folder / "out/controller.yaml"))
    assert loop.lifter.cost == "lifted"
    assert loop.load_model().model_id == load(folder / "out/model.npz").model_id
    assert "model: model.npz" in (folder / "out/controller.yaml").read_text()
    guard = parameters.read(folder / "out/controller.yaml", GUARD)["koop_guard"]
    assert guard["command"] == "/knob:data"  # which alone commands the rig
    assert guard["note"] == str(folder / ".rig.yaml.theta")
    assert rig.params.theta_min <= loop.esc.theta_min < rig.best()[0]
    assert rig.best()[0] < loop.esc.theta_max <= rig.params.theta_max
    assert loop.esc.step_size <= file_of(rig).theta_rate * rig.params.dt
    text = (folder / "out/controller.yaml").read_text()
    assert text.count("# Here: ") > 15
    assert tune_result.read(folder / "out").controller.predicted.excess.high >= 1.0
    assert main(words) == 2
    assert "choose another --out" in capsys.readouterr().err


def test_a_recording_without_theta_is_refused_in_one_line(bagged, capsys):
    folder, rig = bagged
    rig_file.write(replace(file_of(rig), command="/elsewhere:data"), folder / "other.yaml")
    assert main(["tune", str(folder / "other.yaml"), str(folder / "bag"), "--out",
                 str(folder / "no")]) == 2  # fmt: skip
    error = capsys.readouterr().err
    assert "/elsewhere" in error
    assert len(error.splitlines()) == 1
