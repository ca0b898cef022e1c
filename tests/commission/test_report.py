"""The page of a commissioning: what it draws is what was recorded, at every stage."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from browser import browse
from recorded_rig import excited, file_of, loaded_of, rig_of, write_bag

from koop_commission.report import write_report
from koop_core.whole_file import write_json
from koop_lab.cli.main import main
from koop_tune.excitation import progress
from koop_tune.excitation.amplitude import Windows
from koop_tune.excitation.design import KNOWN, Design
from koop_tune.excitation.progress import HoldSummary
from koop_tune.result import tune_result
from koop_tune.rig import rig_file
from koop_tune.rig_model.dwells import find_holds
from koop_tune.search.agreement import Measured
from koop_tune.search.rounds import LoopRun, Round, Verification

QUICK = {"amplitude_time": (2.0, 3.0), "depth": (6.0, 8.0), "noise": (0.01, 0.05),
         "optimum": (0.3, 0.7), "channels": (2, 2), "noise_driven": 0.0}  # fmt: skip
RIG = {**QUICK, "clean": 0.0, "interference": (6.0, 6.0), "common": 1.0,
       "maps": {"symmetric": 1.0}}  # fmt: skip
PHONE, DESK = 390, 1280
pytestmark = pytest.mark.timeout(900)  # the first test waits for the tuning of a rig


def excitation(folder, rig):
    """Make what `koop excite` leaves."""
    file, (theta, x) = file_of(rig), excited(rig, windows=12)
    write_bag(folder / "part-1/bag", rig, theta, x)
    windows = Windows(round(8.0 / rig.frequency / rig.params.dt), rig.params.dt)
    design = Design(file, find_holds(loaded_of(theta, x), file.scale, windows.length), windows)
    holds = [
        HoldSummary(file.theta_at([hold.u]), level.mean, level.error, 1.0, 10.0, "a reason")
        for hold, level in zip(design.holds, design.levels(), strict=True)
    ]
    state = progress.ExcitationProgress(
        design.windows, design.amplitude, holds, theta.size * rig.params.dt, ["part-1"], ended=KNOWN
    )
    progress.save(state, file, folder)
    rig_file.write(file, folder / "rig.yaml")
    return file


def verification(folder, rig, file):
    """Make what `koop verify` leaves: theta on its way to the best one from both ends."""
    best, dt, runs = rig.best()[0], rig.params.dt, []
    rest = round(20.0 / dt)  # before the loop is closed
    for number, start in enumerate((file.theta_min, file.theta_max), 1):
        way = np.concatenate([np.full(rest, 0.5 * (start + best)),
                              np.linspace(start, best, round(60.0 / dt)),
                              np.full(round(40.0 / dt), best)])  # fmt: skip
        bag = f"verify-1/start-{number}/bag"
        write_bag(folder / bag, rig, way, rig.record(way, number)[0], loop=True)
        measured = Measured(60.0, 0.01, 3.0, 0.5, 0.01, 0.01, 1.0, 6.0, (best,), (best,), (best,))
        runs.append(LoopRun((start,), measured, bag, 100.0, (rest, way.size - 1)))
    predicted = tune_result.read(folder / "tuned").controller.predicted
    only = Round(1, predicted, tuple(runs), True, True, "damped as predicted")
    verdict = "The rig is damped.\nThe amplitude is that of x.\nA trade."
    write_json(folder / "verify.json", Verification((only,), True, "x[0]", verdict))


@pytest.fixture(scope="module")
def commissioned(tmp_path_factory):
    """Excite, tune and verify a rig; the pages after each of them."""
    folder = tmp_path_factory.mktemp("rig")
    rig = rig_of(3, **RIG)
    file = excitation(folder, rig)
    pages = {"excited": write_report(folder).read_text()}
    assert main(["tune", str(folder / "rig.yaml"), str(folder),
                 "--effort", "0.001"]) == 0  # fmt: skip
    pages["tuned"] = (folder / "report.html").read_text()
    verification(folder, rig, file)
    pages["verified"] = write_report(folder).read_text()
    return folder, rig, pages


def figures_of(page):
    return json.loads(re.search(r'id="figures">(.*?)</script>', page, re.DOTALL)[1])


def verdict_of(page):
    return re.findall(r"<p>(.*?)</p>", re.search(r'class="verdict">(.*?)</div>', page)[1])


def one(drawn, figure, panel, name):
    """Return what Chromium drew of a curve."""
    (panel_data,) = (d for d in drawn if (d["figure"], d["panel"]) == (figure, panel))
    return next(s for s in panel_data["series"] if s["name"] == name)


@pytest.mark.parametrize(("width", "dark"), [(PHONE, True), (DESK, False)])
def test_the_page_draws_what_was_recorded(commissioned, width, dark, tmp_path):
    folder, rig, pages = commissioned
    result, errors = browse(pages["verified"], width, tmp_path, dark)
    assert errors == []
    assert result["content"] <= result["width"]  # nothing makes the page scroll sideways
    assert (result["empty"], result["wide"], result["small"]) == ([], 0, 0)
    drawn = result["drawn"]
    assert result["plots"] == len(drawn) >= 10
    assert all(plot["whole"] for plot in drawn)  # each column has its curve: bars have two
    # theta of the runs is that of the bags
    best, file = rig.best()[0], file_of(rig)
    for k, start in enumerate((file.theta_min, file.theta_max)):
        theta = one(drawn, f"run-1-{k}", 0, "measured")
        assert theta["least"] == pytest.approx(min(start, best), rel=1e-3)
        assert theta["largest"] == pytest.approx(max(start, best), rel=1e-3)
    tuned = tune_result.read(folder / "tuned")
    # one amplitude a window; it falls as that of the rig itself does
    amplitude = one(drawn, "run-1-0", 1, "measured")
    closed = round(60.0 / rig.params.dt) + round(40.0 / rig.params.dt)
    assert amplitude["count"] == closed // tuned.static_map.amplitude.windows.length
    fall = amplitude["largest"] / amplitude["least"]
    assert fall == pytest.approx(rig.amplitude(file.theta_min) / rig.amplitude(best), rel=0.3)
    # every hold in the static map and in that of every cost
    bars = one(drawn, "map", 0, "hold, two standard errors")
    assert bars["count"] == len(tuned.static_map.holds.theta)
    made = [cost for cost in tuned.costs if cost.r]
    for k, cost in enumerate(made):
        mean = one(drawn, "costs-figure", k, "holds")
        assert mean["least"] == pytest.approx(min(cost.r.level), rel=1e-3)
        assert mean["largest"] == pytest.approx(max(cost.r.level), rel=1e-3)


def test_the_interference_is_marked_and_the_oscillation_is_not(commissioned):
    _, rig, pages = commissioned
    marks = [mark for panel in figures_of(pages["tuned"])["spectra-figure"]["panels"]
             for mark in panel["marks"]]  # fmt: skip
    kinds = {kind: [m["x"] for m in marks if m["name"].startswith(kind)]
             for kind in ("oscillation", "interference")}  # fmt: skip
    for tone in rig.params.tone / (2.0 * np.pi):
        assert min(abs(x / tone - 1.0) for x in kinds["interference"]) < 0.05
        assert all(abs(x / tone - 1.0) > 0.05 for x in kinds["oscillation"])
    assert all(abs(x / rig.frequency - 1.0) > 0.05 for x in kinds["interference"])
    rows = re.findall(r"<td[^>]*>interference</td><td>(.*?)</td><td>(.*?)</td>", pages["tuned"])
    for least, most in rows:
        assert float(least) == pytest.approx(rig.params.tone_amplitude.max(), rel=0.02)
        assert float(most) == pytest.approx(rig.params.tone_amplitude.max(), rel=0.02)


def test_the_best_theta_is_marked_in_its_valley(commissioned):
    _, rig, pages = commissioned
    (mark,) = figures_of(pages["tuned"])["map"]["panels"][0]["marks"]
    span = rig.params.theta_max - rig.params.theta_min
    assert mark["low"] < mark["x"] < mark["high"]
    assert abs(mark["x"] - rig.best()[0]) < 0.1 * span
    assert mark["high"] - mark["low"] < 0.3 * span


def test_every_stage_says_what_is_missing(commissioned):
    _, _, pages = commissioned
    said = {stage: verdict_of(page) for stage, page in pages.items()}
    assert "<span>./koop tune " in pages["excited"]
    assert "predicted" in said["tuned"][1]
    assert "<span>./koop verify " in pages["tuned"]
    assert said["verified"][0] == "The rig is damped."
    for name in ("omega_h", "dwell", "tau_f", "y_out_max"):
        reason = re.search(rf"<td>{name}</td>.*?</tr>", pages["tuned"])[0]
        assert "search" in reason or "times" in reason


def test_a_page_of_a_refusal_shows_the_map_and_what_to_record(tmp_path, capsys):
    folder = tmp_path / "rig"
    rig = rig_of(2, **QUICK, maps={"monotone": 1.0}, clean=1.0)
    excitation(folder, rig)
    assert main(["tune", str(folder / "rig.yaml"), str(folder)]) == 1
    assert f"report in {folder / 'report.html'}" in capsys.readouterr().out
    page = (folder / "report.html").read_text()
    first, why = verdict_of(page)
    assert "monotone" in why
    assert "the limit: there is nothing to seek; leave theta there, or record" in why
    assert "valley" not in first
    result, errors = browse(page, DESK, tmp_path)
    assert errors == []
    (mark,) = figures_of(page)["map"]["panels"][0]["marks"]
    assert mark["x"] == pytest.approx(rig.best()[0], rel=1e-3)  # a limit
    drawn = one(result["drawn"], "map", 0, "map")
    truth = [rig.amplitude(theta) for theta in (rig.params.theta_min, rig.params.theta_max)]
    assert drawn["largest"] / drawn["least"] == pytest.approx(max(truth) / min(truth), rel=0.3)


def test_what_is_torn_or_gone_is_said(commissioned, tmp_path):
    folder, _, _ = commissioned
    rig, state = progress.read(folder)
    progress.save(replace(state, parts=["part-1", "part-2"], ended=""), rig, tmp_path)
    (tmp_path / "part-1").symlink_to(folder / "part-1")
    page = write_report(tmp_path).read_text()
    assert "to resume: ./koop excite" in page


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("excite.json", "", "koop excite"),
        ("tuned/tune.json", "{", "cannot be read"),
        ("tuned/tune.json", '{"verdict": "tuned", "static_map": 1}', "cannot be read"),
        ("tuned/tune.json", '{"verdicts": "tuned"}', "cannot be read"),
    ],
)
def test_a_folder_that_cannot_be_used_is_refused_in_one_line(
    commissioned, tmp_path, name, text, said
):
    folder, _, _ = commissioned
    if name != "excite.json":
        (tmp_path / "excite.json").write_bytes((folder / "excite.json").read_bytes())
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=said) as error:
        write_report(tmp_path)
    assert "\n" not in str(error.value)
