"""``koop bag metrics`` on the golden bag."""

import json
import re
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from koop_bag.bag.reader import BagReader
from koop_bag.bag.writer import BagWriter
from koop_bag.cdr.schema import load_schema
from koop_core.config.fields import parse_source
from koop_guard.guard import Cause
from koop_identify.recording.loop import read_loop
from koop_lab.cli.main import parser
from koop_lab.commands.simulate import run as simulate
from koop_lab.plots.signals import plot_signals
from koop_lab.recorded.report import costs_of, describe, read
from koop_loop.metrics import PAPER
from koop_loop.parameters import make, with_model_beside
from koopman_lifter.config import shipped_model

LOOP = {
    "/state": "koop_msgs/msg/MeasuredState",
    "/cost": "koop_msgs/msg/Cost",
    "/theta": "koop_msgs/msg/ControlInput",
}
GUARD = "/koop_guard/state"
LOOP_AND_RIG = LOOP | {
    "/rig/theta": "std_msgs/msg/Float64",
    GUARD: "koop_msgs/msg/GuardState",
}
RUN = Path(__file__).parents[2] / "recordings" / "golden" / "run"


def command(*options):
    args = parser("bag").parse_args(["bag", *(str(word) for word in options)])
    return args.func(args)


def test_the_metrics_are_those_of_the_recorded_theta(capsys):
    with AnyReader([RUN / "bag"]) as reader:
        topics = [c for c in reader.connections if c.topic == "/theta"]
        theta = np.array([reader.deserialize(raw, c.msgtype).theta[0]
                          for c, _, raw in reader.messages(topics)])  # fmt: skip
    assert command("metrics", RUN, "--json") == 0
    result = json.loads(capsys.readouterr().out)
    error = np.abs(theta + 3.0)
    assert result["iae_theta"] == pytest.approx(0.005 * error.sum(), rel=1e-9)
    assert result["ise_theta"] == pytest.approx(0.005 * (error**2).sum(), rel=1e-9)
    assert result["t_theta"] == pytest.approx(0.005 * np.argmax(error < 0.1))
    values = read(RUN).parameters.as_ros()  # those that this version has
    loop = make(with_model_beside(RUN / "parameters.yaml", values))
    offline, metrics = simulate(replace(loop, pace=replace(loop.pace, duration=theta.size * 0.005)))
    assert np.array_equal(offline.theta, theta)
    assert result["e_r_ss"] == metrics.e_r_ss  # what koop simulate prints of the same run
    assert result["lost"] == {"state": 0, "cost": 0, "theta": 0, "ground_truth": 0}


def guard_state(cause="", status=2, reason="", tripped_at=0.0):
    """Return a GuardState, serialized by rosbags."""
    kind, store = LOOP_AND_RIG[GUARD], get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(load_schema(kind).text.split("=" * 80)[0], kind))
    types, none = store.types, np.empty(0)
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "")
    state = types[kind](header, status, none, cause, reason, tripped_at, none, none, "", 0)
    return bytes(store.serialize_cdr(state, kind))


def read_guarded(path, told, said):
    """Write the golden run with a command, told(k, theta), and what a guard said; read it."""
    with BagReader(RUN / "bag") as reader, BagWriter(path) as writer:
        number = {name: writer.add_topic(name, load_schema(k)) for name, k in LOOP_AND_RIG.items()}
        answers = enumerate(read_loop(RUN / "bag").theta)
        for message in (m for m in reader.messages() if m.topic in LOOP):
            writer.write(number[message.topic], message.log_time, 0, message.data)
            if message.topic == "/theta":
                k, theta = next(answers)
                command = struct.pack("<Id", 256, told(k, theta))
                writer.write(number["/rig/theta"], message.log_time, 0, command)
                if k in said:
                    data = guard_state(**said[k])
                    writer.write(number[GUARD], message.log_time, 0, data)
    return read_loop(path, "/", [parse_source("/rig/theta:data")])


def test_a_limit_of_the_controller_counts_only_while_the_guard_follows_it(tmp_path):
    whole = read_loop(RUN / "bag")
    tripped = round(np.median(np.flatnonzero(whole.limited)))
    told = lambda k, theta: theta if k < tripped else 0.5  # noqa: E731 - 0.5: theta_safe
    guarded = read_guarded(tmp_path / "bag", told, {tripped: {"cause": Cause.BEYOND}})
    assert np.isfinite(guarded.theta[1:]).all()  # nothing was commanded before the first state
    at_limit = np.flatnonzero(guarded.limited)
    assert at_limit.size > 10
    assert guarded.theta[at_limit] == pytest.approx(-5.0)  # the last step to it rounds
    assert at_limit.max() <= tripped < np.flatnonzero(whole.limited).max() - 10


def test_the_way_to_theta_safe_at_the_end_is_not_the_loops(tmp_path):
    whole = read_loop(RUN / "bag").theta.ravel()
    end = whole.size - 200
    said = {end: {"cause": Cause.ENDED}, end + 50: {"cause": Cause.ENDED}}
    told = lambda k, theta: theta if k < end else 0.5  # noqa: E731
    guarded = read_guarded(tmp_path / "bag", told, said)
    known = np.flatnonzero(np.isfinite(guarded.theta))
    assert abs(known.size - end) <= 2
    assert guarded.theta[known].ravel() == pytest.approx(whole[known - 1])  # told before the state


def test_a_trip_is_told_and_nothing_is_compared_with_what_the_guard_held(tmp_path):
    size = read_loop(RUN / "bag").theta.size
    reason = "x = 9 is beyond its limit 8"
    trip = {"cause": Cause.BEYOND, "reason": reason, "tripped_at": -3600.0}
    back = {"cause": Cause.BEYOND, "status": 1}
    until_the_end = {round(0.6 * size): trip}
    read_guarded(tmp_path / "tripped", lambda k, theta: theta, until_the_end)
    text = describe(read(tmp_path / "tripped"))
    assert re.match(rf"the guard tripped at 20\d\d-\S+ \S+: {reason}; still tripped", text)
    assert re.search(r"x\[0\] +[\d.]+ +- +-\n", text)
    assert "theta at the end: not recorded, or held by the guard" in text
    rearmed = until_the_end | {round(0.65 * size): back}
    read_guarded(tmp_path / "rearmed", lambda k, theta: theta, rearmed)
    text = describe(read(tmp_path / "rearmed"))
    assert f"{reason}; rearmed at 20" in text
    assert re.search(r"x\[0\] +[\d.]+ +[\d.]+ +[\d.]+ %\n", text)


def test_of_a_rig_that_is_to_be_maximised_the_growth_is_told():
    run = read(RUN)
    esc = replace(run.parameters.esc, objective="maximise")
    largest = replace(run, parameters=replace(run.parameters, esc=esc))
    for each, word in ((run, "reduction"), (largest, "growth")):
        rows = re.findall(rf"  {word}\n(?:.*\n)*?x\[0\] +(\S+) +(\S+) +(\S+) %\n", describe(each))
        ((before, after, percent),) = [tuple(map(float, row)) for row in rows]
        sign = 1.0 if word == "growth" else -1.0
        assert percent == pytest.approx(sign * 100.0 * (after / before - 1.0), abs=0.2)


def test_of_a_plant_that_was_started_again_the_longest_run_counts(tmp_path, capsys):
    with BagReader(RUN / "bag") as reader:
        messages = [m for m in reader.messages() if m.topic in LOOP]
    step = {topic: 0 for topic in LOOP}
    with BagWriter(tmp_path / "bag") as writer:
        channels = {
            topic: writer.add_topic(topic, load_schema(kind)) for topic, kind in LOOP.items()
        }
        for message in messages:  # 500 steps, then the plant is killed
            if step[message.topic] < 500:
                writer.write(channels[message.topic], message.log_time, 0, message.data)
                step[message.topic] += 1
        for message in messages:
            writer.write(channels[message.topic], message.log_time + 10**10, 0, message.data)
    again, whole = (
        read_loop(tmp_path / "bag").closed(tmp_path / "bag"),
        read_loop(RUN / "bag").closed(RUN / "bag"),
    )
    assert (again.passes, whole.passes) == (2, 1)
    for name in ("step", "measured", "r", "theta"):
        assert np.array_equal(getattr(again, name), getattr(whole, name)), name
    assert command("metrics", tmp_path / "bag") == 0
    printed = capsys.readouterr().out
    assert "the steps begin 2 times: this is the longest run, to step 1999" in printed
    assert "the figures cover 10 of 12.5 s only" in printed
    assert command("metrics", tmp_path / "bag", "--json") == 0
    result = json.loads(capsys.readouterr().out)["coverage"]
    assert (result["covered"], result["recorded"], result["runs"]) == (10.0, 12.5, 2)
    assert not result["whole"]


def numbers(value):
    """Return all numbers of a JSON value."""
    if isinstance(value, dict):
        return [number for item in value.values() for number in numbers(item)]
    return [float(value)] if isinstance(value, int | float) else []


def test_the_table_shows_every_signal_and_json_every_figure_of_it(capsys):
    assert command("metrics", RUN) == 0
    printed = capsys.readouterr().out
    assert "IAE_theta [s]" in printed
    assert command("metrics", RUN, "--json") == 0
    expected = numbers(json.loads(capsys.readouterr().out))
    expected += [100.0 * value for value in expected]  # shares are shown in percent
    expected += [value for metrics in PAPER.values() for value in numbers(metrics.as_dict())]
    text = printed.replace("sqrt(2)", "").replace("last 30 %", "")
    for word in re.findall(r"(?<![\w\[.])-?\d+(?:\.\d+)?(?:e[+-]\d+)?", text):
        tolerance = 0.6 * 10.0 ** -len(word.partition(".")[2].partition("e")[0])
        shown = float(word)
        assert any(shown == pytest.approx(v, rel=1e-3, abs=tolerance) for v in expected), word
    assert {line.split()[0] for line in printed.splitlines() if line} >= {
        "x[0]", "x[1]", "theta", "2000", "true",
    }  # fmt: skip


def test_the_plot_is_written(tmp_path, capsys):
    out = tmp_path / "report.svg"
    assert command("metrics", RUN, "--plot", out) == 0
    assert out.read_bytes().startswith(b"<?xml")
    assert str(out) in capsys.readouterr().out


def test_a_cost_under_the_recorded_model_and_settings_is_the_recorded_one():
    """As computed for the page where a model is named."""
    run = read(RUN)
    costs = costs_of(run, shipped_model())
    assert list(costs) == [f"r under {run.model.model_id}", "recorded r"]
    assert np.array_equal(costs[f"r under {run.model.model_id}"], run.signals.r)
    assert list(costs_of(run)) == ["recorded r"]


def test_a_run_without_a_model_and_with_holes_is_drawn_too(tmp_path):
    run = read(RUN)
    assert run.model is not None
    assert run.model.model_id == read(RUN / "bag").model.model_id
    run.signals.measured[100:130] = np.nan
    signals = run.signals
    states = dict(zip(signals.names, signals.measured.T, strict=True))
    out = tmp_path / "report.png"
    plot_signals(out, signals.t, states, {"r": signals.r}, {}, "holes", None)
    nothing = {"x": np.where(signals.t > 5.0, np.inf, np.nan)}  # a sensor that died at once
    plot_signals(out, signals.t, nothing, nothing, {}, "holes", None)
    assert (tmp_path / "report.png").stat().st_size > 10_000
