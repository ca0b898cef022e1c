"""Which cost is chosen, how long its runs are, and what is written of it."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from surrogate_rigs import FREQUENCY, make_cost, make_findings, make_map, make_task

from koop_core.config.objects import to_json
from koop_core.config.parameter import ConfigError
from koop_core.whole_file import write_json
from koop_guard.config import GUARD, GuardConfig
from koop_loop import parameters
from koop_tune.result import as_text, tune_result
from koop_tune.result.summary import summarise, summarise_refusal
from koop_tune.result.tune_result import TuneResult
from koop_tune.rig.rig_file import RigFile
from koop_tune.search.findings import NoOptimum
from koop_tune.search.limits import ThetaLimits
from koop_tune.search.prediction import predict
from koop_tune.search.run import Outcome
from koop_tune.search.search import Trial, list_anchors, search
from koop_tune.search.settings import SearchSettings, TuningSettings
from koop_tune.search.tune_knobs import KnobsTuning
from koop_tune.search.tuning import SearchedCost, Tuning, choose, limit_slowdown, search_cost

RIG = RigFile("/a:x", "/b:z", 0.02, 0.0, 1.0, 0.5, 0.5, 0.5)


def valley(u):
    return 3.0 * np.abs(u - 0.6)


def of(tuning, rig=RIG):
    return KnobsTuning.of_one(rig, tuning)


def searched(name, score):
    run = Outcome(1.0, 1.0, 0.0, 1.0, np.zeros(1), np.zeros(1), math.log(score))
    task = make_task(valley)
    return SearchedCost(
        make_cost(name, valley), [Trial(list_anchors(task)[0], [run], 0.0, 90.0)], task
    )


@pytest.mark.parametrize(
    ("scores", "name", "why"),
    [
        ({"contrast": 1.2, "raw": 1.3}, "raw", "raw is worse by 8 % only"),
        ({"contrast": 1.2, "raw": 1.5}, "contrast", "raw is worse by 25 %"),
        ({"contrast": 1.2, "lifted": 1.5}, "contrast", "raw does not show the optimum"),
    ],
)
def test_raw_is_chosen_where_no_model_is_better(scores, name, why):
    chosen, reason = choose([searched(*item) for item in scores.items()], as_good=1.1)
    assert chosen.name == name
    assert reason.startswith(why)
    assert "contrast 1.2" in reason


def test_runs_are_made_longer_only_while_the_best_is_not_good():
    rig = RigFile("/a:x", "/b:z", 0.02, 0.0, 1.0, 0.5, 0.5, 0.5,
                  time=1e6)  # fmt: skip
    times = []

    def make(time, level=valley):
        times.append(time)
        return make_task(level, time=time, settings=SearchSettings(length=20.0))

    settings = TuningSettings(effort=0.1, longer=(1.0, 2.0, 4.0), workers=1)
    good = search_cost(make, 6.0, make_cost("raw", valley), rig, settings)
    assert times == [6.0]
    assert good.task.time == 6.0

    def uphill(time):  # theta cannot reach what is good in so short a run
        return make(time, lambda u: 9.0 * np.abs(u - 0.6))

    times.clear()
    strict = TuningSettings(effort=0.1, longer=(0.3, 0.6), workers=1)
    search_cost(uphill, 6.0, make_cost("raw", valley), rig, strict)
    assert times == pytest.approx([1.8, 3.6])
    times.clear()
    hurried = RigFile("/a:x", "/b:z", 0.02, 0.0, 1.0, 0.5, 0.5,
                      0.5, time=1.0)  # fmt: skip
    search_cost(uphill, 6.0, make_cost("raw", valley), hurried, strict)
    assert len(times) == 2  # the second is made, and is too long for this rig


def test_a_rig_counts_as_slower_only_as_far_as_a_run_takes_no_longer_than_its_time():
    settings = TuningSettings(slowdown=16.0)
    slowdown = limit_slowdown(10.0, 2000.0, settings)
    run = settings.search.length * slowdown * 10.0
    assert run == pytest.approx(settings.longest * 2000.0)
    assert limit_slowdown(10.0, 2000.0, TuningSettings(slowdown=2.0)) == 2.0
    assert limit_slowdown(100.0, 2000.0, settings) == 1.0  # as it is


@pytest.fixture(scope="module")
def tuning():
    task = make_task(valley, noise=0.05)
    trials = search(task, 0.125, 0)
    maps = make_cost("raw", valley)
    omega_h = trials[0].constants.omega_h
    maps.maps[omega_h] = make_map(valley)
    chosen = SearchedCost(maps, trials, task)
    observed = make_findings(valley, [maps, make_cost("lifted", None)])
    prediction = predict(task, trials[0], observed, 1, 16)
    return Tuning(observed, [chosen], chosen, trials[0], 123.456, *prediction, "it is good")


def test_the_parameter_file_is_what_was_tuned_with_a_reason_for_each_value(tuning, tmp_path):
    path = tmp_path / "controller.yaml"
    path.write_text(as_text.as_parameters(of(tuning), None))
    loop = parameters.make(parameters.read(path))
    c = tuning.best.constants
    assert loop.lifter.cost == "raw"
    assert loop.lifter.omega_h == pytest.approx(c.omega_h, rel=0.005)
    assert loop.lifter.y_out_max == 123.0
    assert loop.lifter.begin == 2.01
    assert loop.esc.step_size == pytest.approx(c.speed * 0.02, rel=0.005)
    assert loop.esc.theta_initial == RIG.theta_safe
    crosses = float(re.search(r"crosses the range in (\S+) s", path.read_text())[1])
    assert crosses == pytest.approx(1.0 / c.speed, rel=0.01)
    slow = replace(tuning, chosen=replace(tuning.chosen, task=replace(tuning.task, rate=1e-3)))
    assert "crosses the range in 1e+03 s" in as_text.as_parameters(of(slow), None)  # not the same
    guard = parameters.build(parameters.read(path, GUARD), GUARD)["koop_guard"][GuardConfig]
    shared = ("measured", "command", "dt", "theta_min", "theta_max", "theta_rate", "theta_safe")
    assert all(getattr(guard, name) == getattr(RIG, name) for name in shared)
    listed = as_text.list_parameters(of(tuning), None)
    assert all(reason for node in listed.values() for _, reason in node.values())
    lines = [line for line in path.read_text().splitlines() if line.lstrip().startswith("# Here:")]
    assert len(lines) == sum(map(len, listed.values()))
    assert f"{c.omega_h / (2 * math.pi * FREQUENCY):.3g} times" in path.read_text()
    path.write_text(path.read_text().partition("/**/koop_guard")[0])  # a copy that was cut off
    with pytest.raises(ConfigError, match="is cut off"):
        parameters.read(path, GUARD)


def test_a_rig_whose_limits_are_far_apart_steps_the_logarithm_of_theta(tuning, tmp_path):
    far = replace(RIG, theta_min=0.5, theta_max=50.0, theta_start=1.0, theta_safe=40.0,
                  objective="maximise", command="/theta:theta[0]")  # fmt: skip
    task = replace(tuning.task, scale=far.scale, low=0.5, high=50.0, sense=-1.0, rate=0.5)
    findings = replace(tuning.findings, scale=far.scale, limits=ThetaLimits(0.5, 50.0))
    wide = replace(tuning, findings=findings, chosen=replace(tuning.chosen, task=task))
    path = tmp_path / "controller.yaml"
    path.write_text(as_text.as_parameters(of(wide, far), tmp_path / "model.npz"))
    loop = parameters.make(parameters.read(path))
    assert (loop.esc.theta_scale, loop.esc.objective) == ("log", "maximise")
    assert loop.esc.rate_limit == pytest.approx(0.5 / 50.0)  # of log theta, at its largest
    assert loop.esc.step_size <= 0.5 / 50.0 * 0.02 * 1.001
    assert loop.lifter.cost == "lifted"
    assert "model: model.npz" in path.read_text()  # beside the file: the folder may be moved
    assert "a factor of 100 apart" in path.read_text()


def test_table_and_words_hold_every_cost_and_the_prediction(tuning):
    table = as_text.as_table(summarise(of(tuning)))
    assert "evidence" in table
    assert "lifted: too few windows" in table
    assert f"{math.exp(tuning.chosen.score):.3g}" in table
    words = as_text.as_words(of(tuning))
    assert "cost raw: it is good" in words
    assert tuning.prediction.converges.as_text() in words
    assert "\n  amplitude over the best 1" in words
    assert "\n  reduction, a factor of " in words
    largest = replace(tuning, chosen=replace(tuning.chosen, task=replace(tuning.task, sense=-1.0)))
    assert "\n  best over the amplitude 1" in as_text.as_words(of(largest))
    assert "\n  growth, a factor of " in as_text.as_words(of(largest))


def test_the_result_holds_the_map_and_the_paths_and_is_read_as_it_was_written(tuning, tmp_path):
    result = summarise(of(tuning))
    u, maps, fit = tuning.findings.dwells.u, tuning.findings.static_map, result.static_map
    assert fit.holds.level == pytest.approx(np.exp(valley(u)))
    assert (fit.theta_best, fit.best) == (maps.best(), pytest.approx(maps.least))
    half = math.log(1.5) / 3.0  # failed before: 0 to 1, the limits, which are the rig's own
    assert fit.valley == pytest.approx((0.6 - half, 0.6 + half), abs=0.05)
    limits = ThetaLimits(0.0, 0.8)
    narrow = summarise(of(replace(tuning, findings=replace(tuning.findings, limits=limits))))
    assert narrow.static_map.valley == (fit.valley.low, 0.8)
    raw, lifted = result.costs
    assert raw.r.level == pytest.approx(np.exp(2.0 * valley(u)))
    assert (lifted.r, lifted.problem) == (None, "too few windows")
    for path, start in zip(result.controller.paths, (0.0, 1.0), strict=True):
        assert path.start == start
        assert abs(path.theta.middle[0] - start) < 0.2
        assert path.theta.middle[-1] == pytest.approx(0.6, abs=0.1)
        assert all(a <= b for a, b in zip(path.theta.low, path.theta.high, strict=True))
    write_json(tmp_path / "tune.json", result)
    read = tune_result.read(tmp_path)
    assert to_json(read) == to_json(result)
    assert read.controller.paths == result.controller.paths
    assert read.make_aim(RIG).bound == result.make_aim(RIG).bound
    refused = summarise_refusal(NoOptimum("flat", "nothing reacts"))
    write_json(tmp_path / "tune.json", refused)
    assert tune_result.read(tmp_path) == refused == TuneResult("flat", "nothing reacts")
