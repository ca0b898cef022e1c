"""The report's sentences, stages, tables and figures, of folders whose content is known."""

import html
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koop_commission.report.contents import Contents, read_contents
from koop_commission.report.loop import make_loop
from koop_commission.report.sections import (
    make_constants,
    make_costs,
    make_rig,
    make_sections,
    make_static_map,
)
from koop_commission.report.spectra import COARSER, FINE, find_peaks, group
from koop_commission.report.verdict import DONE, MISSING, NO, list_stages, write_sentences
from koop_commission.report.write import try_report, write_report
from koop_commission.stages.verify import format_verdict
from koop_core.config.parameter import ConfigError
from koop_core.whole_file import write_json
from koop_tune.excitation import progress
from koop_tune.excitation.amplitude import Amplitude, Windows
from koop_tune.excitation.design import FLAT, KNOWN, TIME
from koop_tune.excitation.progress import ExcitationProgress, HoldSummary, SectionLine
from koop_tune.excitation.static_map import Interval
from koop_tune.result.tune_result import (
    AmplitudeMap,
    ControllerResult,
    CostResult,
    Curves,
    LoopPath,
    ParameterResult,
    Points,
    TuneResult,
)
from koop_tune.rig.rig_file import RigFile
from koop_tune.rig_model.spectra import Spectra
from koop_tune.search.agreement import Measured
from koop_tune.search.prediction import Band, Prediction
from koop_tune.search.rounds import LoopRun, Round, Verification
from koop_tune.search.run import Constants

DT = 0.01
RIG = RigFile(
    "/a:x", "/b:z", DT, -1.0, 3.0, 0.5, 2.0, 0.5
)  # fmt: skip
THETA = [-1.0, 1.0, 3.0]
PREDICTION = Prediction(
    Band(30.0, 40.0, 60.0), Band(0.01, 0.02, 0.03), Band(1.0, 1.02, 1.05), Band(3.5, 3.8, 4.0),
    400.0, 64,
)  # fmt: skip
WINDOWS = Windows(200, DT)
ONE = np.eye(1, len(WINDOWS.edges) - 1, 3)
AMPLITUDE = Amplitude(WINDOWS, ONE, 0.0, 0.01, np.full(ONE.shape, np.inf))  # of x at 2 Hz
PATH = LoopPath(
    -1.0, [1.0, 2.0],
    Curves([-1.0, 0.8], [-0.9, 0.9], [-0.8, 1.0]), Curves([3.0, 1.0], [3.5, 1.1], [4.0, 1.2]),
)  # fmt: skip
COST = CostResult("raw", 1234.0, 1.2, "", 0.9, Points(THETA, [8.0, 0.5, 5.0], [0.1] * 3))
BLIND = CostResult("lifted", 1234.0, None, "no model", None, None)
FIT = AmplitudeMap(
    "x", AMPLITUDE, [], 0.9, math.log(0.95), 0.1, Interval(0.8, 1.1), 0.0, 0.5, 0.0,
    Points(THETA, [4.0, 1.0, 3.0], [0.1] * 3), Points(THETA, [4.0, 1.0, 3.0], [0.1, 0.2, 0.1]),
)  # fmt: skip
CONTROLLER = ControllerResult(
    "raw", "", Constants("adaptive", 10.0, 1.0, 0.1, 0.25, 1.0, 0.1), 1.0, PREDICTION,
    [PATH, PATH._replace(start=3.0)],
    [ParameterResult("dwell", 0.25, "s", "search", "relay_esc")],
)  # fmt: skip
TUNED = TuneResult("tuned", "as good as any", FIT, [COST, BLIND], CONTROLLER)
REFUSED = replace(TUNED, verdict="flat", controller=None,
                  why="the amplitude varies by 3 % with errors of 4 %")  # fmt: skip
MEASURED = Measured(50.0, 0.02, 4.0, 1.1, 0.01, 0.01, 1.1, 3.6, (0.9,), (0.8,), (1.0,))


def excitation(holds=(), ended=KNOWN, elapsed=60.0):
    return ExcitationProgress(WINDOWS, AMPLITUDE, list(holds), elapsed, ended=ended)


def holds():
    return [HoldSummary((theta,), math.log(a), 0.1, 2.0, 8.0, "over the range")
            for theta, a in zip(THETA, (4.0, 1.0, 3.0), strict=True)]  # fmt: skip


def contents(tuned=TuneResult(), rounds=(), verdict="", **changes):  # noqa: B008
    """Return the contents of a folder that holds no file."""
    state = changes.pop("excitation", excitation(holds()))
    verification = Verification(tuple(rounds), False, "x", verdict)
    return Contents(Path("run"), replace(RIG, **changes), state, tuned, verification)


def round_of(number=1, agrees=True, excess=1.1):
    runs = (
        LoopRun((-1.0,), replace(MEASURED, excess=excess), "verify-1/start-1/bag", 90.0, (0, 9)),
    )
    return Round(number, PREDICTION, runs, agrees, bool(agrees), "damped as predicted")


def states(c):
    return {stage.name: stage.state for stage in list_stages(c)}


def test_each_stage_has_its_state_and_the_command_that_makes_it():
    new = contents(excitation=excitation(ended=""))
    assert states(new) == {"Rig": DONE, "Excite": MISSING, "Tune": MISSING, "Verify": MISSING}
    texts = [stage.text for stage in list_stages(new)]
    assert texts[0] == "x measured; theta on /b"
    assert texts[1] == ("0 holds in 60 s; to resume: ./koop excite RIG.YAML --out run")
    assert states(contents(TUNED)) == {"Rig": DONE, "Excite": DONE, "Tune": DONE, "Verify": MISSING}
    assert list(list_stages(contents()))[2].text == "./koop tune RIG.YAML run"
    assert list(list_stages(contents(TUNED)))[3].text == "./koop verify RIG.YAML run"
    assert states(contents(REFUSED))["Tune"] == NO
    assert states(contents(TUNED, [round_of()]))["Verify"] == DONE
    assert states(contents(TUNED, [round_of(agrees=False)]))["Verify"] == NO
    assert states(contents(TUNED, [round_of(), round_of(2, None)]))["Verify"] == MISSING


@pytest.mark.parametrize(
    ("ended", "elapsed", "state", "why"),
    [
        (KNOWN, 60.0, DONE, "the map is known"),
        (FLAT, 60.0, NO, "nothing reacts"),
        (
            TIME,
            1801.0,
            NO,
            "the 1800 s of the rig file were over before the static map was known: "
            "set time = 4700 in it (it ends once the map is known, after 2400 s or more) and run "
            "the same command again",
        ),
        (
            TIME,
            60.0,
            NO,
            "the static map is not known yet, and more holds would not help: noise hides the "
            "oscillation, or the rig changes while theta is held; measure where it is stronger, or "
            "set narrower limits of theta, and choose another --out",
        ),
    ],
)
def test_an_excitation_that_ended_says_why(ended, elapsed, state, why):
    done = replace(excitation(holds(), ended, elapsed), needed=2345.0)
    stage = list(list_stages(contents(excitation=done)))[1]
    assert (stage.state, stage.text) == (state, f"3 holds in {elapsed:.0f} s: {why}")


def test_two_sentences_say_what_is_known():
    rig, controller = write_sentences(contents(excitation=excitation(ended="")))
    assert rig == "The oscillation over theta from -1 to 3 is not known yet."
    assert controller == "Cost and constants are not chosen yet."
    rig, _ = write_sentences(contents())
    assert rig.endswith("the amplitude of x at 2 Hz is between 1 at 1 and 4 at -1.")
    doubtful = replace(TUNED, controller=replace(CONTROLLER, doubt="a limit"))
    rig, controller = write_sentences(contents(doubtful))
    assert rig.endswith("; its valley is from 0.8 to 1.1.")
    assert "converge in 40 (30 to 60) s and to stay within a factor of 1.02" in controller
    assert controller.endswith("In doubt: a limit.")


def test_the_strongest_motion_is_told_though_its_hold_is_put_aside():
    state = excitation(holds()[1:], ended="")
    state.aside = holds()[:1]
    rig = write_sentences(contents(excitation=state))[0]
    assert rig.endswith("is between 1 at 1 and 4 at -1.")


def test_the_largest_amplitude_is_the_best_where_it_is_maximised():
    rig = write_sentences(contents(objective="maximise"))[0]
    assert rig.endswith("between 4 at -1 and 1 at 1.")


def test_what_is_far_from_the_best_is_told_as_below_it_where_that_is_the_largest():
    for objective, valley, *rows in (
        ("minimise", "at most 1.5 times the best", "amplitude over the best",
         "reduction, a factor of"),
        ("maximise", "at least 1/1.5 of the best", "best over the amplitude",
         "growth, a factor of"),
    ):  # fmt: skip
        c = contents(TUNED, [round_of()], objective=objective)
        assert valley in make_static_map(c).intro
        assert {*rows} <= {column.title for column in make_loop(c).tables[0].columns}
        said = format_verdict(c.verification, c.verification.rounds[0], c.rig.sense)
        assert all(f"\n{row} " in said for row in rows)


def test_a_refusal_gives_its_reason_which_says_what_to_do():
    _, *others = write_sentences(contents(REFUSED))
    assert others == [f"No controller (flat): {REFUSED.why}."]


def test_the_verdict_of_a_verification_is_shown_in_its_lines():
    verdict = "The rig is damped.\nThe amplitude is that of x.\n"
    assert write_sentences(contents(TUNED, [round_of()], verdict)) == [
        "The rig is damped.", "The amplitude is that of x.",
    ]  # fmt: skip


def test_sections_follow_how_far_the_commissioning_has_come():
    names = [[part.name for part in make_sections(c)]
             for c in (contents(), contents(REFUSED), contents(TUNED))]  # fmt: skip
    assert names[0] == ["rig-section", "map-section", "spectra"]
    assert names[1] == ["rig-section", "map-section", "spectra", "costs"]
    assert names[2][3:] == ["costs", "loop", "constants-section"]


def test_a_folder_of_any_name_is_the_title_of_its_page(tmp_path):
    (folder := tmp_path / "R&D <1>").mkdir()
    progress.save(excitation(holds()), RIG, folder)
    page = write_report(folder).read_text()
    for tag in ("title", "h1"):
        (text,) = re.findall(f"<{tag}>(.*?)</{tag}>", page)
        assert html.unescape(text) == "Commissioning: R&D <1>"
        assert "<1>" not in text


def test_the_rig_file_is_a_table_with_the_meaning_of_each_key():
    section = make_rig(contents(pace=4.0))
    assert section.intro == "No recording yet."
    (table,) = section.tables
    assert table.cell("pace", "value") == "4"
    assert table.cell("dt", "unit") == "s"
    assert "least theta" in table.cell("theta_min", "meaning")


def test_the_static_map_has_holds_fit_errors_and_the_best_theta_with_its_valley():
    section = make_static_map(contents(TUNED))
    (panel,) = section.figures[0].panels
    assert [s.kind for s in panel.series] == ["band", "line", "bars"]
    assert panel.series[0].upper == pytest.approx(
        np.array([4.0, 1.0, 3.0]) * np.exp([0.2, 0.4, 0.2])
    )
    bars = panel.series[-1]
    assert bars.y == pytest.approx(np.array([4.0, 1.0, 3.0]) / math.exp(0.2))
    assert bars.upper == pytest.approx(np.array([4.0, 1.0, 3.0]) * math.exp(0.2))
    (mark,) = panel.marks
    assert (mark.x, mark.low, mark.high) == (0.9, 0.8, 1.1)
    assert "moved" not in section.intro
    moved = replace(TUNED, static_map=replace(FIT, motion=0.2))
    note = "Note: it looks as if the optimum moved by 20 % of the range"
    assert note in make_static_map(contents(moved)).intro
    cut_short = FIT.holds._replace(error=[math.inf, 0.1, 0.1])  # the first was cut short
    short = make_static_map(contents(replace(TUNED, static_map=replace(FIT, holds=cut_short))))
    bars = short.figures[0].panels[0].series[-1]
    assert (bars.y[0], bars.upper[0], bars.upper[1] > bars.y[1]) == (4.0, 4.0, True)
    falling = replace(REFUSED, verdict="monotone", static_map=replace(FIT, theta_best=2.9))
    monotone = make_static_map(contents(falling))
    assert monotone.figures[0].panels[0].marks[0].x == 3.0  # the limit
    assert "Refused (monotone)" in monotone.intro
    own = make_static_map(contents())  # of the excitation, before it is tuned
    (bars,) = own.figures[0].panels[0].series
    assert bars.x == [-1.0, 1.0, 3.0]
    assert own.tables[0].cell(2, "why") == "over the range"
    assert make_static_map(contents(excitation=excitation())).figures == []


def test_costs_are_compared_and_the_chosen_one_is_named():
    section = make_costs(contents(TUNED))
    (table,), (figure,) = section.tables, section.figures
    assert table.cell("raw", "evidence") == "1234"
    assert table.cell("lifted", "problem") == "no model"
    assert [panel.title for panel in figure.panels] == ["raw (chosen)"]  # the other has no map
    assert section.intro.endswith("Chosen: raw. As good as any.")
    assert "None was tried" in make_costs(contents(replace(REFUSED, costs=[]))).intro


def test_constants_are_listed_with_their_reasons():
    (table,) = make_constants(contents(TUNED)).tables
    assert table.rows == [("dwell", "0.25", "s", "search", "relay_esc")]


def test_the_loop_is_predicted_until_it_is_measured():
    section = make_loop(contents(TUNED))
    assert [figure.name for figure in section.figures] == ["predicted-0", "predicted-1"]
    assert "Not measured yet: ./koop verify RIG.YAML run" in section.intro
    assert section.tables[0].cell("round 1: predicted", "time_to_converge") == "40 (30 to 60)"
    levels = [s.y[0] for panel in section.figures[0].panels for s in panel.series
              if s.kind == "level"]  # fmt: skip
    assert levels == [0.9, 1.0]  # the best theta, the best amplitude


def test_a_round_is_compared_with_its_prediction_also_without_its_bag():
    never = replace(round_of(), runs=(LoopRun((2.5,), replace(MEASURED, time_to_converge=None)),))
    section = make_loop(contents(TUNED, [never]))
    (table,), (figure,) = section.tables, section.figures
    assert table.title == "round 1: damped as predicted"
    assert table.cell("measured", "time_to_converge") == "never"
    assert table.cell("measured", "reduction") == "3.6"
    assert "from theta = 2.5: not drawn" in figure.caption


def test_lines_that_theta_does_not_change_are_interference():
    seconds, bins = 10.0, 400
    power = np.full((3, 1, bins), 1e-4)
    power[:, 0, 48] = [9.0, 1.0, 4.0]  # 5 Hz: theta changes it
    power[:, 0, 198] = 2.0  # 20 Hz: it does not, only what is beside it
    sure = np.zeros((1, bins), bool)
    sure[0, [48, 197, 199]] = True
    spectra = Spectra(seconds, DT, np.array([0.0, 0.5, 1.0]), power, sure)
    peaks = find_peaks(spectra, 0)
    assert [(round(p.line.frequency, 2), p.kind) for p in peaks] == [
        (5.0, "oscillation"), (20.0, "interference")
    ]  # fmt: skip
    # a line of density p over df = 1 / seconds is a sine of power p df
    assert peaks[0].most == pytest.approx(math.sqrt(2.0 * 9.0 * DT / seconds), rel=0.01)
    assert peaks[0].least == pytest.approx(math.sqrt(2.0 * 1.0 * DT / seconds), rel=0.01)
    assert peaks[1].least == pytest.approx(peaks[1].most)


def test_a_long_spectrum_is_thinned_by_ratio_and_a_short_one_is_not():
    assert group(np.arange(1.0, 11.0)).tolist() == list(range(10))
    frequency = np.arange(1.0, 5001.0)
    starts = group(frequency)
    assert starts[:FINE].tolist() == list(range(FINE))
    assert starts.size < 500
    ratios = frequency[starts[FINE + 1 :]] / frequency[starts[FINE:-1]]
    assert ratios.max() <= COARSER + 1.0 / FINE


def test_a_folder_is_read_and_written_as_a_page(tmp_path):
    with pytest.raises(ConfigError, match=r"has no excite.json: name a folder of 'koop excite'"):
        read_contents(tmp_path)
    assert try_report(tmp_path).startswith("no report: ")
    progress.save(excitation(holds()), RIG, tmp_path)
    (tmp_path / "tuned").mkdir()
    write_json(tmp_path / "tuned/tune.json", TUNED)
    read = read_contents(tmp_path)
    assert (read.rig, read.tuned.controller, read.verification.rounds) == (RIG, CONTROLLER, ())
    page = write_report(tmp_path).read_text()
    assert page.count("<section>") == 6
    assert "no recording yet" in page


def test_of_several_knobs_each_has_its_map_its_worth_and_its_path():
    """The amplitude is sqrt(1 + |M (u - u*)|^2): the drawn valley is where it is 1.5."""
    m, best = np.array([[6.0, 3.0], [0.0, 4.0]]), np.array([0.4, 0.6])
    rig = replace(RIG, command="/b:p,q", theta_min=(-1.0, 0.0), theta_max=(3.0, 10.0))
    u = [(v, 0.6) for v in np.linspace(0.0, 1.0, 9)] + [(0.4, v) for v in np.linspace(0.0, 1.0, 9)]
    u += [(0.6, 0.8), (0.6, 0.3)]
    a = [math.hypot(1.0, *(m @ (np.array(at) - best))) for at in u]
    state = excitation(
        HoldSummary(rig.theta_at(at), math.log(y), 0.01, 1.0, 9.0)
        for at, y in zip(u, a, strict=True)
    )
    state.sections = [SectionLine(knob, rig.theta_at(best)) for knob in (0, 1)]
    loop = replace(CONTROLLER, paths=[])
    tuned = replace(TUNED, static_map=replace(FIT, knob=1), controller=loop)
    run = LoopRun((-1.0, 10.0), replace(MEASURED, theta=(0.6, 6.0)), "verify-1/bag", 9.0, (0, 9))
    rounds = [Round(1, PREDICTION, (run,), True, True, "")]
    c = replace(contents(tuned, rounds, excitation=state), rig=rig)
    section = make_static_map(c)
    assert [panel.x_label for panel in section.figures[0].panels] == ["q"]  # p has no effect
    assert section.tables[0].rows[0] == ("p", None, "no effect", 1.0)
    assert section.tables[0].rows[1][:2] == ("q", 0.9)
    (pair,) = section.figures[1].panels
    *held, valley = pair.series
    assert sum(len(series.x) for series in held) == len(u)
    for edge in (valley.y, valley.upper):
        ways = rig.u(np.column_stack([valley.x, edge])) - best
        along = np.hypot(1.0, np.linalg.norm(ways @ m.T, axis=1))
        assert along == pytest.approx(1.5, rel=0.03)
    loop = make_loop(c)
    panels = loop.figures[0].panels
    assert [panel.y_label for panel in panels] == ["p", "q", "amplitude"]
    assert [series.name for series in panels[1].series] == ["best q"]
    assert "[-1, 10]" in loop.tables[0].rows[1]
    assert write_sentences(c)[0].startswith("Over theta from [-1, 0] to [3, 10] the amplitude")
