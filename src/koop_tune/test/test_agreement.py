"""A closed loop measured: against an oscillation whose amplitude and theta are known exactly."""

import json
import math
from dataclasses import asdict, replace

import numpy as np
import pytest

from koop_core.config.parameter import ConfigError
from koop_tune.rig.rig_file import RigFile
from koop_tune.search.agreement import (
    find_disagreements,
    make_aim,
    may_yet_agree,
    measure,
    read_aim,
    verdict,
)
from koop_tune.search.rounds import (
    LoopRun,
    Round,
    Verification,
    find_slowdown,
    kept_index,
    load_verification,
    save_verification,
)
from koop_tune.search.settings import VerificationSettings

DT, PERIOD, TAU, BEST = 0.01, 0.5, 20.0, 0.7
RIG = RigFile(
    "/a:x", "a/msg/A", "/b:z", "std_msgs/msg/Float64", DT, -1.0, 3.0, 0.5, 2.0, 0.5
)  # fmt: skip
BANDS = {
    "duration": 400.0, "runs": 64,
    "converges": {"low": 30.0, "middle": 40.0, "high": 60.0},
    "distance": {"low": 0.01, "middle": 0.02, "high": 0.03},
    "excess": {"low": 1.0, "middle": 1.02, "high": 1.05},
    "reduction": {"low": 3.5, "middle": 3.8, "high": 4.0},
}  # fmt: skip
FIGURES = {
    "windows": {"length": 200, "edges": [1, 3, 5, 9], "dt": DT, "feature": 0},
    "feature": "x", "theta_best": BEST, "time": 20.0, "predicted": BANDS,
    "static_map": {"theta": [-1.0, BEST, 3.0], "amplitude": [4.0, 1.0, 3.0], "error": [0.1] * 3},
}  # fmt: skip


def run(aim, upside=False, floor=1.0, swing=0.2):
    """Return what is measured of an amplitude that falls from 4 to a floor, or rises to its end."""
    t = np.arange(round(aim.duration / DT)) * DT
    amplitude = floor + (4.0 - floor) * np.exp(-t / TAU)
    amplitude = 4.0 / amplitude if upside else amplitude
    x = 5.0 + amplitude * np.sin(2 * np.pi * t / PERIOD)
    before = amplitude[0] * np.sin(2 * np.pi * t[:1600] / PERIOD)
    theta = BEST + 0.5 * swing * np.sign(np.sin(t)) + 2.0 * np.exp(-t / 5.0)
    return measure(aim, before[:, None], x[:, None], theta)


def test_a_run_is_measured_as_its_truth_is():
    aim = make_aim(FIGURES, RIG)
    assert aim.duration == 120.0  # twice the time that the prediction allows
    assert aim.longest == 400.0
    found = run(aim)
    # converged: within 1.5 times the best
    assert found.time_to_converge == pytest.approx(TAU * math.log(6.0), abs=3 * aim.window)
    assert found.amplitude_before == pytest.approx(4.0, rel=0.02)
    assert found.excess == pytest.approx(1.0, abs=0.1)
    assert found.reduction == pytest.approx(4.0, rel=0.1)
    assert found.distance == pytest.approx(0.1 / 4.0, abs=0.002)
    assert (found.swing, found.theta) == pytest.approx((0.2, BEST), abs=0.01)
    assert find_disagreements(aim, found) == []
    said = verdict(aim, [found, found], 1, "there")
    assert said.count(". ") == 2
    assert said.startswith(f"From 2 starts theta ends at {found.theta:.3g} and")
    assert said.endswith("The rig is damped as predicted: ./koop up there runs it.")


def test_an_amplitude_that_is_to_be_large_is_judged_the_other_way_round():
    aim = make_aim(FIGURES | {"theta_best": -1.0}, replace(RIG, objective="maximise"))
    found = run(aim, upside=True)
    assert found.excess == pytest.approx(1.0, abs=0.1)
    assert found.reduction == pytest.approx(4.0, rel=0.1)
    assert found.time_to_converge is not None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time_to_converge": 90.0}, "took 90 s to converge, at most 60 s were predicted"),
        ({"time_to_converge": None}, "did not converge, at most 60 s were predicted"),
        ({"excess": 1.2}, "ended at 1.2 times the best amplitude, at most 1.05"),
        ({"reduction": 2.0}, "changed the amplitude by a factor of 2, at least 3.5"),
        ({"excess": 0.5, "reduction": 9.0, "time_to_converge": 1.0}, None),
    ],
)
def test_only_what_is_worse_than_the_band_disagrees(change, message):
    aim = make_aim(FIGURES, RIG)
    found = find_disagreements(aim, replace(run(aim), error=0.01, **change))
    assert found == [] if message is None else (len(found) == 1 and message in found[0])
    longer = message is not None and "converge" not in message  # a smaller step may still come
    rough = replace(run(aim), error=0.9, excess=1.6)  # agrees, for what little is known of it
    assert may_yet_agree(aim, rough)
    assert not find_disagreements(aim, rough)
    assert may_yet_agree(aim, replace(run(aim), error=0.01, **change)) == longer
    worse = replace(run(aim), **{"excess": 2.0, **change}, error=0.0)
    said = verdict(aim, [run(aim), worse], 3, "there")
    assert ("not damped after 3 rounds" in said) == (worse.excess > 1.5)


def test_a_prediction_that_allows_anything_is_not_confirmed():
    wide = {**BANDS, "excess": {**BANDS["excess"], "high": 3.4}}
    aim = make_aim(FIGURES | {"predicted": wide}, RIG)
    (said,) = find_disagreements(aim, run(aim))
    assert not may_yet_agree(aim, replace(run(aim), excess=9.0))
    assert "to 3.4 times the best amplitude, is too wide to be confirmed" in said
    assert "damped, but after 2 rounds not as predicted" in verdict(aim, [run(aim)], 2, "there")


def rounds_of(*rounds, excess=1.0):
    """Return rounds of which each is told by whether it agrees and the times of its runs."""
    aim = make_aim(FIGURES, RIG)
    measured = run(aim)
    return [
        Round(number, aim.predicted,
              tuple(LoopRun(-1.0, replace(measured, time_to_converge=time, excess=excess))
                    for time in times), agrees)
        for number, (agrees, *times) in enumerate(rounds, 1)
    ]  # fmt: skip


def test_a_rig_that_was_slower_than_predicted_is_taken_for_a_slower_one():
    for rounds in ([], [(None,)], [(True, 90.0, 90.0)]):
        assert find_slowdown(rounds_of(*rounds)) == 1.0
    assert find_slowdown(rounds_of((False, 30.0, 90.0))) == 1.5
    assert find_slowdown(rounds_of((False, 30.0, 40.0))) == 1.0  # another figure disagreed
    assert find_slowdown(rounds_of((False, 90.0, 30.0), (False, None, 50.0))) == 6.0


def test_the_last_round_is_kept_if_it_damped_as_predicted_else_the_best_one():
    (unlike,) = rounds_of((False, 1.0, 1.0), excess=1.2)
    (damped,) = rounds_of((True, 1.0), excess=1.3)
    (weak,) = rounds_of((True, 1.0, 1.0), excess=1.83)
    assert damped.damped_as_predicted
    assert not weak.damped_as_predicted
    assert kept_index([unlike, damped]) == 1
    assert kept_index([unlike, weak]) == 0
    assert "but 1.83 times the best" in weak.agreement
    assert damped.agreement == "as predicted, or better"


def test_a_verification_is_read_as_it_was_written():
    rounds = rounds_of((False, None, 50.0), (None,))
    written = Verification(tuple(rounds), True, "x", "Three sentences.")
    values = json.loads(json.dumps(written.as_json()))
    assert values["rounds"][0]["runs"][0]["time_to_converge"] is None
    read = Verification.from_json(values)
    assert read.as_json() == values
    assert read.rounds[0].prediction == rounds[0].prediction
    assert read.finished == read.rounds[:1]
    del values["rounds"][0]["prediction"]
    with pytest.raises(KeyError, match="prediction"):
        Verification.from_json(values)


def test_a_folder_without_a_controller_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="koop tune first"):
        read_aim(tmp_path / "tune.json", RIG)
    (tmp_path / "tune.json").write_text('{"verdict": "flat"}')
    with pytest.raises(ConfigError, match="holds no controller"):
        read_aim(tmp_path / "tune.json", RIG)
    assert set(asdict(run(make_aim(FIGURES, RIG)))) >= {"time_to_converge", "distance", "reduction"}


def test_a_verification_is_kept_in_its_folder(tmp_path):
    assert load_verification(tmp_path) == Verification()
    kept = Verification(tuple(rounds_of((True, 40.0, 50.0))), True, "x", "It is damped.")
    save_verification(kept, tmp_path)
    assert load_verification(tmp_path).as_json() == kept.as_json()
    (tmp_path / "verify.json").write_text('{"rounds": [{"round": 1}]}')
    with pytest.raises(ConfigError, match=r"verify\.json: cannot be read .*: move it away"):
        load_verification(tmp_path)


def test_how_strictly_a_loop_is_compared_is_a_setting():
    aim = make_aim(FIGURES, RIG)
    late = replace(run(aim), time_to_converge=90.0, error=0.01)
    assert find_disagreements(aim, late)
    patient = replace(aim, settings=VerificationSettings(later=2.0))
    assert find_disagreements(patient, late) == []
    assert patient.duration == aim.duration
    assert replace(aim, settings=VerificationSettings(twice=4.0)).duration == 240.0
    assert find_slowdown(rounds_of((False, None)), VerificationSettings(most_slower=2.0)) == 2.0
