"""``koop report``: its figures and sentences are those of the days that were written down."""

import html
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from browser import browse
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from koop_msgs.msg import ControlInput, Cost, GuardState, LoopSummary, MeasuredState
from mcap.reader import make_reader
from rclpy.serialization import serialize_message
from std_msgs.msg import Header

from koop_bag.bag.writer import BagWriter, WriterOptions
from koop_bag.cdr.schema import load_schema
from koop_core.ended import Ended, note_end
from koop_lab.cli.main import main
from koop_lab.history.seconds import TABLES, Rows, with_guard

BEGIN = 1_795_000_020  # [s since the epoch]: a full minute
EVERY = 20  # [s] from second to second that is written
DAY = 86400
TRIP, BACK, REARMED = 30_000, 30_100, 30_900  # [s] after BEGIN
SAFE = -2.0
ILL = 50_000
GUARD = "koop_msgs/msg/GuardState"


def amplitude_at(t):
    """Return the amplitude of the first channel, as it is written; it doubles in a trip."""
    return 0.1 + 0.4 * np.exp(-t / 5000.0) + 0.5 * ((t >= TRIP) & (t < REARMED))


def write_days(folder, begin=0, end=DAY, closed=True):
    """Write a run with a ring: its long-term record, and an empty bag."""
    with BagWriter(folder / "summary", WriterOptions(chunk_seconds=600.0)) as writer:
        summary = writer.add_topic("/summary", load_schema("koop_msgs/msg/LoopSummary"))
        guard = writer.add_topic("/koop_guard/state", load_schema(GUARD))
        health = writer.add_topic(
            "/diagnostics", load_schema("diagnostic_msgs/msg/DiagnosticArray")
        )

        def write(channel, t, message):
            time = (BEGIN + t) * 10**9
            writer.write(channel, time, time, serialize_message(message))

        write(guard, begin, GuardState(status=1, theta=[0.0]))
        for t in range(0 if begin else 10):  # a node says each second what lasts
            status = DiagnosticStatus(name="/recorder", message=f"{t} lost")
            status.level = b"\1" if t < 9 else b"\0"
            write(health, begin + t, DiagnosticArray(status=[status]))
        for t in range(begin, end, EVERY):
            if t == TRIP:
                trip = {"cause": "told to", "reason": "told to by a test", "tripped_theta": [1.25]}
                write(guard, t, GuardState(status=2, theta=[1.25], **trip))
            if t == BACK:
                write(guard, t, GuardState(status=2, theta=[SAFE], **trip))
            if t == REARMED:
                write(guard, t, GuardState(status=1, theta=[SAFE], **trip))
            for name, at, lasts in (("/relay_esc", ILL, 60), ("/koop_guard", TRIP, 900)):
                for when, level in ((at, b"\2"), (at + lasts, b"\0")):
                    if t == when - when % EVERY:
                        text = "the cost is unusable" if level != b"\0" else ""
                        status = DiagnosticStatus(name=name, level=level, message=text)
                        write(health, when, DiagnosticArray(status=[status]))
            amplitude = float(amplitude_at(t))
            header = Header()
            header.stamp.sec = BEGIN + t
            write(summary, t + 1, LoopSummary(
                header=header, count=200, model_id="old" if t < DAY / 2 else "new",
                x_min=[-amplitude, 2.0], x_max=[amplitude, 2.0], x_mean=[0.0, 2.0],
                x_std=[amplitude / np.sqrt(2.0), 0.0], r_min=0.5, r_max=2.0, r_mean=1.0,
                margin_min=-0.1, margin_max=0.3, margin_mean=0.2,
                theta_min=[t / DAY - 0.5], theta_max=[t / DAY + 0.5], theta_mean=[t / DAY],
            ))  # fmt: skip
        ended = GuardState(status=2, theta=[SAFE], cause="ended", reason="the loop ends")
        write(guard, end - EVERY + 1, ended)  # theta returns, which is not a trip
    with BagWriter(folder / "bag") as bag:
        if not closed:
            bag._file.abandon()
            bag.closed = True


def read_page(path):
    """Return the panels of the page by title, and its text."""
    page = path.read_text()
    figures = json.loads(re.search(r'id="figures"[^>]*>(.*?)</script>', page, re.S)[1])
    (panels,) = [figure["panels"] for figure in figures.values()]
    text = html.unescape(re.sub(r"<[^>]+>", " ", page.split("<body>")[1].split("<script")[0]))
    return {panel["title"].split(",")[0].split(":")[0]: panel for panel in panels}, text


@pytest.fixture(scope="module")
def week(tmp_path_factory):
    folder = tmp_path_factory.mktemp("loop")
    write_days(folder / "20260101T000000Z-mine", 0, DAY // 2, closed=False)
    write_days(folder / "verify-1" / "20260101T120000Z-mine", DAY // 2 + 3600, DAY)
    return folder


def test_the_figures_show_what_was_written_and_nothing_where_nothing_was(week, capsys):
    assert main(["report", str(week)]) == 0
    panels, _ = read_page(week / "history.html")
    band, curve, *_ = panels["Amplitude"]["series"]
    t = np.array(curve["x"])
    shown = np.array(curve["y"], float)
    gap = (t > BEGIN + DAY / 2 + 120) & (t < BEGIN + DAY / 2 + 3480)
    assert not np.isfinite(shown[gap]).any()
    known = np.isfinite(shown)
    away = known & (np.abs(t - BEGIN - TRIP) > 200) & (np.abs(t - BEGIN - REARMED) > 200)
    # a curve's point is of some minutes, in which the amplitude falls by a few percent
    np.testing.assert_allclose(shown[away], amplitude_at(t[away] - BEGIN), rtol=0.03)
    assert max(v for v in band["upper"] if v) == pytest.approx(amplitude_at(TRIP), rel=0.01)
    band, mean = panels["Theta"]["series"]
    low, high = (np.array(band[key], float) for key in ("y", "upper"))
    assert low[0] == pytest.approx(-0.5, abs=1e-2)
    assert np.nanmax(high) == pytest.approx(1.5, abs=1e-2)
    t, theta = np.array(mean["x"]) - BEGIN, np.array(mean["y"], float)
    back = (t > BACK) & (t < REARMED - 120)  # the guard's, whatever the controller asks for
    assert back.any()
    assert set(theta[back]) == {SAFE}
    after = (t > REARMED + 120) & np.isfinite(theta)
    assert theta[after] == pytest.approx(t[after] / DAY, abs=2e-3)
    low, high, shown = (np.array(line, float) for line in (
        *(panels["Margin of the constraint"]["series"][0][key] for key in ("y", "upper")),
        panels["Margin of the constraint"]["series"][1]["y"],
    ))  # fmt: skip
    for values, expected in ((low, -0.1), (high, 0.3), (shown, 0.2)):
        assert values[np.isfinite(values)] == pytest.approx(expected, abs=1e-6)
    (mark,) = panels["Theta"]["marks"]
    assert (mark["low"], mark["high"]) == (BEGIN + TRIP, BEGIN + REARMED)
    assert {max(s["y"]) for s in panels["Health"]["series"]} == {2}


def test_theta_is_the_guards_while_it_has_tripped_and_moves_in_between():
    time, of_controller = np.arange(10.0), np.full((10, 3, 2), 5.0)
    rows = Rows(time, np.ones(10), np.zeros((10, 1)), *(of_controller for _ in TABLES))
    said = np.array([0.0, 2.5, 6.5, 8.2]), np.outer([5.0, 1.0, -1.0, -1.0], [1.0, -2.0])
    theta = with_guard(rows, *said, np.array([False, True, True, False])).theta
    np.testing.assert_allclose(theta[7], [[-1.0, 2.0]] * 3)  # of each knob
    theta = theta[:, :, 0]
    assert (theta[[0, 1, 2, 9]] == 5.0).all()
    np.testing.assert_allclose(theta[3], [0.25, 0.75, 0.5])  # falls by 0.5 a second
    np.testing.assert_allclose(theta[6, :2], [-1.0, -0.75])
    np.testing.assert_allclose(theta[[7, 8]], -1.0)


def test_each_thing_that_happened_has_a_sentence(week, capsys):
    assert main(["report", str(week)]) == 0
    _, text = read_page(week / "history.html")
    for sentence in (
        "2 runs, 95.81 % of the time",  # an hour of a day is missing
        "tripped 1 time, and kept theta from the controller for 15 min",
        "tripped at theta = 1.25: told to by a test",
        "rearmed after 15 min",
        "relay_esc said ERROR for 1 min: the cost is unusable",
        "recorder said WARN for 9 s: 0 lost",
        "The cost came from model new in place of old",
        "This recording was not closed",
        "1.01 h without one",
    ):
        assert sentence in text
        assert text.count(sentence) == 1
    assert "koop_guard said" not in text  # its trip is told


@pytest.mark.parametrize(
    ("ended", "told"),
    [
        (
            Ended(BEGIN + 590, "relay_esc was killed by signal 9", "theta is left at -2"),
            "The loop ended by a fault: relay_esc was killed by signal 9; theta is left at -2.",
        ),
        (Ended(), "The loop ended by a fault: koop up was killed"),
        (Ended(BEGIN + 590), ""),
    ],
)
def test_an_end_of_the_loop_that_was_a_fault_is_told_with_its_cause(tmp_path, ended, told, capsys):
    """Failed before: nothing of it was told, and "The guard did not trip."."""
    write_days(tmp_path / "run", 0, 600)
    (tmp_path / "run" / "logs").mkdir()
    note_end(tmp_path / "run" / "logs", ended)
    assert main(["report", str(tmp_path)]) == 0
    _, text = read_page(tmp_path / "history.html")
    events = text.split("what happened")[-1]
    assert told in events
    assert ("The guard did not trip." in text) == (not told)
    assert ("The loop failed 1 time, at last " in text) == bool(told)
    assert ("koop up" not in told) or "theta was last recorded at -2, on its way" in events


def test_a_recorder_that_was_lost_is_told_with_the_time(tmp_path, capsys):
    write_days(tmp_path / "run", 0, 600, closed=False)
    (tmp_path / "run" / "logs").mkdir()
    lost = ((BEGIN + 300.0, "recorder was killed by signal 9"),)
    note_end(tmp_path / "run" / "logs", Ended(BEGIN + 900.0, lost=lost))
    assert main(["report", str(tmp_path)]) == 0
    _, text = read_page(tmp_path / "history.html")
    assert "recorder was killed by signal 9; the loop went on without it" in text
    assert "This recording was not closed" not in text


def write_guard(folder, begin, end, *messages):
    """Write a run of a guard whose messages come at times, and a state a second."""
    with BagWriter(folder / "bag") as writer:
        state = writer.add_topic("/state", load_schema("koop_msgs/msg/MeasuredState"))
        guard = writer.add_topic("/koop_guard/state", load_schema(GUARD))
        times = [(BEGIN + t, state, MeasuredState(step=t, x=[0.0])) for t in range(begin, end)]
        for t, values in messages:
            message = GuardState(**values)
            message.header.stamp.sec = BEGIN + t
            times.append((BEGIN + t, guard, message))
        for time, channel, message in sorted(times, key=lambda item: item[0]):
            writer.write(channel, time * 10**9, time * 10**9, serialize_message(message))


def test_what_a_guard_left_that_outlasted_its_recording_is_not_claimed(tmp_path, capsys):
    """Failed before: "the guard left theta at 0.64828", though it returned it to 0.3."""
    trip = {"status": 2, "cause": "ended", "reason": "the process that started the loop was killed"}
    write_guard(tmp_path, 0, 60, (0, {"status": 1}), (59, {"theta": [0.64828], **trip}))
    (tmp_path / "logs").mkdir()
    note_end(tmp_path / "logs", Ended())
    assert main(["report", str(tmp_path)]) == 0
    _, text = read_page(tmp_path / "history.html")
    assert "theta was last recorded at 0.64828, on its way to theta_safe or there" in text
    assert "the guard left" not in text


def test_runs_of_the_simulated_plant_are_left_out_beside_those_of_a_rig(tmp_path, capsys):
    """Failed before: the golden bag was mixed into the figures of an operator's rig."""
    write_days(tmp_path / "mine", 0, 600)
    golden = Path(__file__).parents[2] / "recordings" / "golden" / "run"
    shutil.copytree(golden, tmp_path / "golden" / "run")
    assert main(["report", str(tmp_path)]) == 0
    told = capsys.readouterr()
    assert "recorded in 1 run, 100 % of the time" in told.out
    assert f"{tmp_path / 'golden' / 'run'} is left out, its plant is simulated" in told.err
    assert main(["report", str(tmp_path / "golden")]) == 0
    assert "is left out" not in capsys.readouterr().err


def test_a_trip_that_is_latched_over_restarts_is_one_event(tmp_path, capsys):
    """Failed before: a trip for each start, and the last one lasted for less than nothing."""
    trip = {"status": 2, "cause": "told to", "reason": "told to by a test"}
    first = {**trip, "tripped_at": BEGIN + 20.0, "tripped_theta": [1.25]}
    again = {**first, "theta": [SAFE]}
    other = {**trip, "tripped_at": BEGIN + 370.0, "tripped_theta": [0.75]}
    following, waiting = {"status": 1, "theta": [0.0]}, {"status": 0, "theta": [SAFE]}
    write_guard(tmp_path / "a", 0, 60, (0, following), (20, first), (30, again))
    write_guard(tmp_path / "b", 100, 160, (100, waiting), (105, again))
    write_guard(tmp_path / "c", 200, 260, (200, waiting), (205, again), (240, following))
    write_guard(tmp_path / "d", 300, 360, (300, following), (350, trip))  # rearmed elsewhere
    write_guard(tmp_path / "e", 365, 370, (365, waiting), (372, other))  # said after all else
    assert main(["report", str(tmp_path)]) == 0
    _, text = read_page(tmp_path / "history.html")
    assert "tripped 3 times" in text
    assert text.count("tripped at theta = 1.25: told to by a test") == 1
    assert "rearmed after 3.67 min" in text
    assert "; the recording ended after 9 s" in text
    assert "not rearmed until the end, for 0 s" in text


def test_only_the_last_hours_are_shown_where_so_asked(week, capsys):
    assert main(["report", str(week), "--since", "6h"]) == 0
    panels, text = read_page(week / "history.html")
    times = panels["Cost"]["series"][0]["x"]
    assert min(times) >= BEGIN + DAY - 6 * 3600 - 60
    assert "The guard did not trip" in text
    assert main(["report", str(week), "--since", "six hours"]) == 2
    assert "such as 7d, 12h or 30m" in capsys.readouterr().err


def test_a_recording_that_keeps_all_is_reported_from_its_messages(tmp_path, capsys):
    types = {"/state": MeasuredState, "/cost": Cost, "/theta": ControlInput}
    t = np.arange(0.0, 60.0, 0.01)
    x = 0.7 * np.sin(2.0 * np.pi * 0.2 * t)  # slower than a second
    with BagWriter(tmp_path / "bag") as writer:
        channels = {
            topic: writer.add_topic(topic, load_schema(f"koop_msgs/msg/{kind.__name__}"))
            for topic, kind in types.items()
        }
        for k in range(t.size):
            time = BEGIN * 10**9 + round(t[k] * 1e9)
            for topic, values in (
                ("/state", {"x": [x[k]]}),
                ("/cost", {"r": 1.0, "margin": np.nan}),
                ("/theta", {"theta": [3.0]}),
            ):
                message = types[topic](step=k, **values)
                writer.write(channels[topic], time, time, serialize_message(message))
    assert main(["report", str(tmp_path)]) == 0
    panels, text = read_page(tmp_path / "history.html")
    _, curve = panels["Amplitude"]["series"]
    assert curve["y"] == pytest.approx([0.7] * len(curve["y"]), rel=0.01)
    assert len(curve["y"]) == 6
    assert "Margin of the constraint" not in panels
    assert "No guard was recorded." in text


def test_where_a_loop_begins_and_ends_is_not_taken_for_how_it_does(tmp_path, capsys):
    with BagWriter(tmp_path / "bag") as writer:
        channel = writer.add_topic("/state", load_schema("koop_msgs/msg/MeasuredState"))
        for k in range(9000):
            time = BEGIN * 10**9 + k * 10**7
            size = 0.7 if 1000 <= k < 8000 else 5.0
            message = MeasuredState(step=k, x=[size * np.sin(2.0 * np.pi * k / 100)])
            writer.write(channel, time, time, serialize_message(message))
    assert main(["report", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "x[0] as measured, with any interference: 0.7 at first, 0.7 at last" in said
    assert "at most 5 over 10 s" in said


def test_the_second_in_which_a_recording_begins_is_reported(tmp_path, capsys):
    with BagWriter(tmp_path / "bag") as writer:
        channel = writer.add_topic("/state", load_schema("koop_msgs/msg/MeasuredState"))
        for k in range(2):
            time = BEGIN * 10**9 + 700_000_000 + k * 100_000_000
            message = MeasuredState(step=k, x=[float(k)])
            writer.write(channel, time, time, serialize_message(message))
    assert main(["report", str(tmp_path)]) == 0
    assert "0.1 s recorded in 1 run" in capsys.readouterr().out


def test_a_loop_of_which_a_channel_more_is_measured_since_is_one_loop(tmp_path, capsys):
    write_days(tmp_path / "20260102T000000Z-mine", DAY // 2, DAY)  # two channels
    with BagWriter(tmp_path / "20260101T000000Z-mine" / "bag") as writer:
        channel = writer.add_topic("/state", load_schema("koop_msgs/msg/MeasuredState"))
        for k in range(6000):
            time = BEGIN * 10**9 + k * 10**7
            message = MeasuredState(step=k, x=[np.sin(2.0 * np.pi * k / 100)])
            writer.write(channel, time, time, serialize_message(message))
    assert main(["report", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "Amplitude of x[1] as measured, with any interference: 0 at first, " in printed
    panels, _ = read_page(tmp_path / "history.html")
    assert [len(series["x"]) > 2 for series in panels["Amplitude"]["series"]] == [True] * 4
    assert panels["Amplitude"]["series"][1]["y"][0] == pytest.approx(1.0, rel=0.01)
    assert panels["Amplitude"]["series"][3]["y"][0] is None


def test_runs_of_several_loops_and_folders_without_a_run_are_refused(week, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    assert main(["report", str(tmp_path / "empty")]) == 2
    for name in ("mine", "other"):
        with BagWriter(tmp_path / f"20260101T000000Z-{name}" / "bag"):
            pass
    assert main(["report", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert "holds no run" in error
    assert "holds runs of mine, other: name the folders of one" in error
    assert "Traceback" not in error


def test_a_damaged_bag_is_named_and_the_others_are_reported(tmp_path, capsys):
    for run, begin in enumerate((0, 60, 120)):
        with BagWriter(tmp_path / f"2026010{run + 1}T000000Z-mine" / "bag") as writer:
            channel = writer.add_topic("/state", load_schema("koop_msgs/msg/MeasuredState"))
            for k in range(3000):
                time = (BEGIN + begin) * 10**9 + k * 10**7
                message = MeasuredState(step=k, x=[np.sin(2.0 * np.pi * k / 100)])
                writer.write(channel, time, time, serialize_message(message))
    files = sorted(tmp_path.rglob("*.mcap"))
    data = bytearray(files[1].read_bytes())
    with open(files[1], "rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    middle = chunks[len(chunks) // 2].chunk_start_offset + 200  # not its head: others follow
    data[middle : middle + 64] = bytes(64)
    files[1].write_bytes(data)
    files[2].write_bytes(b"of no bag")
    assert main(["report", str(tmp_path)]) == 0
    told, notes = capsys.readouterr()
    assert "2 runs" in told
    panels, text = read_page(tmp_path / "history.html")
    times = np.array(panels["Amplitude"]["series"][1]["x"])
    assert times.min() < BEGIN + 30
    assert BEGIN + 60 < times.max() < BEGIN + 90  # what stands before the damage
    for words in ("is damaged: ", "`koop bag recover` saves the rest", "is not an MCAP file"):
        assert words in notes
        assert words in text
    run = files[1].parents[1]
    assert f"what './koop bag recover {run / 'bag'}' makes of it is read in its place" in notes
    assert main(["bag", "recover", str(run)]) == 0
    assert main(["report", str(tmp_path)]) == 0
    assert str(run) not in capsys.readouterr().err
    times = read_page(tmp_path / "history.html")[0]["Amplitude"]["series"][1]["x"]
    assert max(times) >= BEGIN + 85  # what stands behind the damage, too
    files[1].write_bytes(data)  # what is written after it was recovered is not in it
    assert main(["report", str(tmp_path)]) == 0
    assert str(run) in capsys.readouterr().err
    for file in files:
        file.write_bytes(b"of no bag")
    assert main(["report", str(tmp_path)]) == 2
    assert "holds no recording with a message in it; " in (error := capsys.readouterr().err)
    assert "is not an MCAP file" in error


def test_a_run_of_which_a_later_ring_has_dropped_the_files_is_reported_without_a_fault(
    tmp_path, capsys
):
    run = tmp_path / "20261101T000000Z-rig"
    write_days(run)
    for path in (run / "bag").iterdir():
        path.unlink()
    assert main(["report", str(tmp_path)]) == 0
    assert "left out" not in "".join(capsys.readouterr())
    assert "Amplitude" in read_page(tmp_path / "history.html")[0]


def test_a_time_before_the_clock_was_set_does_not_stretch_the_axis(tmp_path, capsys):
    boot = 30
    for run, times in (("a", (boot,)), ("b", (boot, BEGIN)), ("c", (BEGIN + 60,))):
        with BagWriter(tmp_path / run / "bag") as writer:
            channel = writer.add_topic("/state", load_schema("koop_msgs/msg/MeasuredState"))
            for k in range(1000 * len(times)):
                time = times[k // 1000] * 10**9 + k % 1000 * 10**7
                message = MeasuredState(step=k, x=[np.sin(2.0 * np.pi * k / 100)])
                writer.write(channel, time, time, serialize_message(message))
    assert main(["report", str(tmp_path)]) == 0
    told, notes = capsys.readouterr()
    assert "20 s recorded in 2 runs" in told
    assert f"{tmp_path / 'a'} is left out, its clock was not set: name its folder alone" in notes
    panels, _ = read_page(tmp_path / "history.html")
    assert {x // DAY for x in panels["Amplitude"]["series"][1]["x"]} == {BEGIN // DAY}
    assert main(["report", str(tmp_path / "a")]) == 0
    panels, _ = read_page(tmp_path / "a" / "history.html")
    assert max(panels["Amplitude"]["series"][1]["x"]) < 60


@pytest.mark.parametrize(("width", "dark"), [(390, True), (1280, False)])
def test_the_page_is_drawn_by_a_browser(week, width, dark, tmp_path):
    assert main(["report", str(week)]) == 0
    result, errors = browse((week / "history.html").read_text(), width, tmp_path, dark)
    assert errors == []
    assert result["content"] <= result["width"]
    assert (result["empty"], result["wide"], result["small"]) == ([], 0, 0)
    assert result["plots"] == len(result["drawn"]) == 5
    assert all(plot["whole"] for plot in result["drawn"])
    assert 0.3 < result["zoomed"] < 0.7
    assert "UTC" in result["read"][0]
