"""`koop tune`: what it chooses is tried on the rig itself, whose truths are known."""

import json
import math
from dataclasses import replace
from itertools import pairwise

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
from scipy.signal import lfilter

from koop_identify.recording.loaded import Loaded
from koop_lab.cli.main import main
from koop_loop import parameters
from koop_study.commissioning.excitation import training_of
from koop_tune.excitation.features import Bands
from koop_tune.excitation.optimum_test import best_end
from koop_tune.rig import rig_file
from koop_tune.rig_model.fluctuation import fluctuation
from koop_tune.rig_model.static_map import StaticMap
from koop_tune.rig_model.stays import Scale, Stay, Stays, period_by_theta, rests
from koop_tune.rig_model.surrogate import fit_times
from koop_tune.search.tuning import NoOptimum, limits_of, look, tune
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
    found = tune(*recorded(rig), effort=0.1)
    assert found.chosen.cost.name.startswith(cost)
    best = found.seen.scale.theta_at(found.seen.amplitude.best())
    assert abs(best - rig.best()[0]) < 0.1 * (rig.params.theta_max - rig.params.theta_min)
    predicted = found.prediction.excess
    assert 0.9 < predicted.low <= predicted.middle <= predicted.high < 1.5
    for end in (0, 1):
        got = damped(rig, found, seed=100 + end, end=end)
        assert got < 1.5
        # the amplitude of the recording holds noise, and its map has nine points
        assert predicted.low - 0.1 < got < predicted.high + 0.1


@pytest.mark.parametrize(
    ("name", "kind"), [("monotone", "monotone"), ("flat", "flat"), ("drowned", "flat")]
)
def test_a_rig_without_an_optimum_is_refused(name, kind):
    rig = rig_of(2, **QUICK, maps={name: 1.0}, clean=1.0, noise_driven=0.0)
    with pytest.raises(NoOptimum, match=r"record|leave theta there") as no:
        look(*recorded(rig, windows=12))
    assert no.value.kind == kind
    if name == "monotone":
        worst = rig.best()[0] > 0.5 * (rig.params.theta_min + rig.params.theta_max)
        assert f"theta_{'max' if worst else 'min'}" in str(no.value)


def test_a_valley_is_told_from_a_slope_by_its_errors():
    u, rng = np.linspace(0.0, 1.0, 9), np.random.default_rng(0)

    def gains(curve, error):
        drawn = [curve + rng.normal(0.0, error, 9) for _ in range(200)]
        maps = [StaticMap(u, y, np.full(9, error), 1.0, [y[i : i + 1] for i in range(9)])
                for y in drawn]  # fmt: skip
        return np.mean([m.interior for m in maps])

    assert gains((u - 0.6) ** 2, 0.02) > 0.99
    for nothing in (u, -u, 0.0 * u, np.maximum(u, 0.5)):
        assert gains(nothing, 0.02) <= 0.02


def test_a_rest_that_lost_messages_cut_short_does_not_hide_the_period():
    dt, rest, short = 0.02, 1600, 64
    theta = np.repeat([0.0, 1.0, 2.0, 3.0, 4.0, 1.5], [rest] * 5 + [short])
    t = dt * np.arange(theta.size)
    noise = np.random.default_rng(0).normal(0.0, 0.3, t.size)
    x = (1.0 + (theta - 2.0) ** 2) * np.sin(2.0 * np.pi * t) + noise  # 1 Hz
    begins = np.zeros(t.size, bool)
    begins[0] = True
    recording = Loaded(x[None], begins, np.zeros(t.size, bool), theta, t)
    assert period_by_theta(recording, Scale(0.0, 4.0), dt) == pytest.approx(1.0, rel=0.1)


def test_the_time_constant_is_that_of_the_rig():
    rig = rig_of(4, **{**QUICK, "amplitude_time": (20.0, 20.0)}, clean=1.0, noise_driven=0.0)
    loaded, file, training = recorded(rig, stay=5.0)
    seen = look(loaded, file, training)
    times = fit_times(loaded, seen.stays, seen.amplitude, seen.scale, file.dt)
    tau = [times.tau(float(a), up) for a in seen.amplitude.mean for up in (True, False)]
    # d a^2/dt = a^2 (1 - a^2 / L^2) / tau: near L the amplitude's own time is tau
    assert 0.4 * rig.slowest < np.median(tau) < 2.0 * rig.slowest


@pytest.mark.parametrize("tau", [2.0, 8.0])
def test_the_time_constant_of_what_noise_drives_is_that_of_its_process(tau):
    """A complex Ornstein-Uhlenbeck process, exactly sampled; measurement noise, drifting levels."""
    window, per, rng = 1.0, 50, np.random.default_rng(1)
    dt = window / per
    keep = math.exp(-dt / tau)
    stays, amplitude = [], []
    for level in [*range(9), *range(9)]:
        steps = per * 120
        white = rng.normal(size=(2, steps)) * math.sqrt((1.0 - keep**2) / 2.0)
        z = lfilter([1.0], [1.0, -keep], white, axis=1) * rng.uniform(0.8, 1.25)
        power = (z**2).sum(axis=0).reshape(-1, per).mean(axis=1) * (1.0 + 0.2 * level)
        amplitude.append(0.5 * np.log(power + 0.05 * rng.chisquare(2, power.size)))
        stays.append(Stay(level, 0, steps, 0))
    how = Bands(per, (1, 2), dt)
    found = fluctuation(Stays(np.linspace(0.0, 1.0, 9), stays, how, 0, amplitude))
    assert 0.6 * tau < found.time < 1.4 * tau
    assert found.share > 0.3


def test_what_is_best_at_a_limit_is_said_only_beyond_doubt():
    error = np.full(5, 0.1)
    assert best_end(np.array([0.0, 0.4, 0.8, 1.2, 1.6]), error) == 0
    assert best_end(np.array([1.6, 1.2, 0.8, 0.4, 0.0]), error) == 4
    assert best_end(np.array([0.0, 0.02, 0.2, 1.0, 2.0]), error) is None  # may be better beside it
    assert best_end(np.array([0.1, 0.0, 0.8, 1.2, 1.6]), error) is None


def test_an_optimum_in_doubt_is_tuned_for_and_said():
    """Below the optimum little gets worse, less than the errors; above it much does."""
    rig = rig_of(3, **{**QUICK, "optimum": (0.85, 0.85)}, clean=1.0, noise_driven=0.0,
                 maps={"one-sided": 1.0}, quiet=0.0)  # fmt: skip
    loaded, file, training = recorded(rig, windows=12)
    noisy = loaded.x + np.random.default_rng(0).normal(0.0, 2.0 * loaded.x.std(), loaded.x.shape)
    found = look(replace(loaded, x=noisy), file, training)
    assert "towards theta_min is not sure" in found.doubt
    assert any(judged.usable for judged in found.costs)


def cliff_map(values, edge, calm_once=False):
    """The map of a rig that gets better up to an edge and oscillates beyond it."""
    u = Scale(0.5, 60.0).u(np.array(values))
    visits = [np.full(2, -2.0 * own if theta < edge else 4.0)
              for own, theta in zip(u, values, strict=True)]  # fmt: skip
    if calm_once:  # the first value beyond, when it was come to from below
        i = int(np.argmax(np.array(values) >= edge))
        visits[i] = np.array([-2.0 * u[i], 4.0])
    mean = np.array([own.mean() for own in visits])
    return StaticMap(u, mean, np.full(u.size, 0.05), 1.0, visits)


def test_theta_is_kept_away_from_a_cliff_that_is_known():
    rig = replace(file_of(rig_of(3)), theta_min=0.5, theta_max=60.0, theta_start=1.0,
                  theta_safe=1.0, objective="minimise")  # fmt: skip
    values = [0.5, 0.91, 1.66, 3.01, 5.48, 9.97, 11.6, 13.4, 18.1, 33.0, 60.0]
    scale = Scale(0.5, 60.0)

    def limits(values, edge, calm_once=False):
        found = cliff_map(values, edge, calm_once)
        return limits_of(found, found, scale, rig)

    for calm_once in (False, True):
        found = limits(values, 13.0, calm_once)
        assert "all at once" in found.why_high
        assert 8.0 < found.high < 10.0
        assert "theta_max" in found.why_high
    assert "all at once" not in limits(values, 70.0).why  # there is none
    coarse = [v for v in values if v not in (11.6, 13.4)]  # the optimum may be anywhere before it
    assert "all at once" not in limits(coarse, 13.0).why
    assert limits(coarse, 13.0).high > 13.0


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_theta_is_kept_where_the_map_is_good_and_has_room_there(sense):
    rig = replace(file_of(rig_of(3)), theta_min=-5.0, theta_max=5.0, theta_start=2.0,
                  theta_safe=2.0)  # fmt: skip
    scale, u = Scale(-5.0, 5.0), np.linspace(0.0, 1.0, 21)

    def limits(slope, error):
        mean = sense * slope * np.abs(u - 0.4)
        found = StaticMap(u, mean, np.full(u.size, error), sense, [np.full(2, y) for y in mean])
        return limits_of(found, found, scale, rig)

    found = limits(5.0, 0.01)  # 1.5 times the best at 0.4 +- log(1.5) / 5, and a little for errors
    for limit, side in ((found.low, -1), (found.high, 1)):
        assert scale.u(np.array(limit)) == pytest.approx(0.4 + side * (0.081 + 0.1), abs=0.02)
    assert "instead of 5" in found.why
    unsure = limits(5.0, 0.2)  # what may be good is not left out
    assert unsure.low < found.low
    assert unsure.high > found.high
    assert limits(0.5, 0.01) == (-5.0, 5.0, "", "")  # good everywhere


def test_a_theta_that_moves_slowly_does_not_rest_on_its_way():
    values = np.linspace(0.0, 1.0, 9)
    way = [np.linspace(a, b, 2001)[1:] for a, b in pairwise(values)]
    theta = np.concatenate([part for v, w in zip(values, [*way, []], strict=True)
                            for part in (np.full(1000, v), w)])  # fmt: skip
    loaded = loaded_of(theta, np.zeros((theta.size, 1)))
    u, found = rests(loaded, Scale(0.0, 1.0), 16)
    assert u == pytest.approx(values)
    assert [(b - a) // 16 for _, a, b in found] == [62] * 9


def test_rests_of_a_loop_do_not_join_the_values_of_the_excitation():
    values = [*np.linspace(0.0, 1.0, 9), *np.arange(0.0, 1.0, 0.015)]
    theta = np.repeat(values, 100)
    u, _ = rests(loaded_of(theta, np.zeros((theta.size, 1))), Scale(0.0, 1.0), 16)
    assert u.size > 9
    assert np.diff(u).max() < 0.05


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
    assert (loop.esc.command_topic, loop.esc.command_field) == ("/knob", "data")
    assert rig.params.theta_min <= loop.esc.theta_min < rig.best()[0]
    assert rig.best()[0] < loop.esc.theta_max <= rig.params.theta_max
    assert loop.esc.step_size <= file_of(rig).theta_rate * rig.params.dt
    text = (folder / "out/controller.yaml").read_text()
    assert text.count("# Here: ") > 15
    figures = json.loads((folder / "out/tune.json").read_text())
    assert figures["predicted"]["excess"]["high"] >= 1.0
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
