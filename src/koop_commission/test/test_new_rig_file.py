"""Answers of a rig file's questions: taken, asked again, or refused from a pipe."""

import io

import numpy as np
import pytest

from koop_commission.fitness.samples import Samples
from koop_commission.stages.new_rig_file import (
    Interview,
    ask,
    propose_limits,
)
from koop_core.config.parameter import ConfigError


def answer(monkeypatch, text, terminal=False):
    stdin = io.StringIO(text)
    stdin.isatty = lambda: terminal
    monkeypatch.setattr("sys.stdin", stdin)


def test_an_empty_line_takes_the_proposal(monkeypatch, capsys):
    answer(monkeypatch, "\n")
    assert ask("time", "1800", float, "for all") == 1800.0
    assert capsys.readouterr().out == "for all\ntime [1800]: 1800\n"


def test_a_wrong_answer_is_asked_again_at_a_terminal_and_refused_from_a_pipe(monkeypatch, capsys):
    def parse(text):
        return Interview(None, []).parse("dt", text)

    answer(monkeypatch, "abc\n0.5\n", terminal=True)
    assert ask("dt", "", parse) == 0.5
    assert "'abc' is not a number" in capsys.readouterr().out
    answer(monkeypatch, "abc\n0.5\n")
    with pytest.raises(ConfigError, match="dt: 'abc' is not a number; nothing was written"):
        ask("dt", "", parse)


def test_no_more_answers_are_an_error_that_names_the_question(monkeypatch):
    answer(monkeypatch, "")
    with pytest.raises(ConfigError, match="no more answers at 'dt': nothing was written"):
        ask("dt", "1", float)


@pytest.mark.parametrize(
    ("name", "text", "error"),
    [
        ("theta_min", "-1.5", None),
        ("dt", "0", r"dt = 0: must be 1e-06 to 1 s"),
        ("theta_max", "-2", r"theta_min = -1 must be below theta_max = -2"),
        ("theta_start", "9", r"theta_start = 9: must lie within .* \[-1, 3\]"),
        ("theta_safe", "nan", "theta_safe = nan: must be a finite number"),
    ],
)
def test_a_number_fits_its_range_and_the_values_before(name, text, error):
    values = {"theta_min": -1.0, "theta_max": 3.0} if name != "theta_min" else {}
    if error is None:
        assert Interview(None, [], values).parse(name, text) == float(text)
        return
    with pytest.raises(ConfigError, match=error):
        Interview(None, [], values).parse(name, text)


def test_several_knobs_take_one_number_or_one_each():
    values = {"command": "/b:p,q", "theta_min": (-1.0, 0.0), "theta_max": (3.0, 0.3)}
    interview = Interview(None, [], values)
    assert interview.parse("theta_start", "0.2") == 0.2
    assert interview.parse("theta_start", "2.5, 0.1") == (2.5, 0.1)
    with pytest.raises(ConfigError, match=r"theta_start = 1 of q: must lie within .* \[0, 0.3\]"):
        interview.parse("theta_start", "2.5 1")
    with pytest.raises(ConfigError, match=r"one for each of at most|has 3 values"):
        interview.parse("theta_start", "1 2 3")


def test_proposed_limits_leave_room_also_beside_an_offset():
    least, most = np.array([-1.0, 52280.3, 1.0]), np.array([1.0, 52283.3, 1.000002])
    low, high = ([float(word) for word in text.split()] for text in propose_limits(least, most))
    np.testing.assert_allclose(low, [-7.0, 52271.3, 0.999994], rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(high, [7.0, 52292.3, 1.000008], rtol=0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("value", "note", "limits"),
    [
        (0.0, "none proposed: a channel stands still, as one that follows theta", ((), ())),
        (0.5, "a channel that follows theta needs its range", ((-7.0, -1.5), (7.0, 2.0))),
    ],
)
def test_no_limits_are_proposed_where_a_channel_stands_still(
    monkeypatch, capsys, value, note, limits
):
    """Failed before: a channel that showed theta, 0 at rest, got -3 to 3, and theta went beyond."""
    samples = Samples(*np.zeros((3, 2)), np.array([[-1.0, 0.0], [1.0, value]]))
    interview = Interview(None, [], {"measured": "/rig:x,theta"})
    answer(monkeypatch, "\n\n")
    interview._ask_limits(samples)
    assert (interview.values["channel_min"], interview.values["channel_max"]) == limits
    assert note in capsys.readouterr().out


def test_limits_are_as_many_as_channels_and_the_largest_above_the_least():
    interview = Interview(None, [], {"measured": "/rig:x,y", "channel_min": (-1.0, 0.0)})
    assert interview.parse("channel_max", "none") == ()
    assert interview.parse("channel_max", "1, 2") == (1.0, 2.0)
    assert Interview(None, [], {"measured": "/rig:x"}).parse("channel_max", "1") == (1.0,)
    with pytest.raises(ConfigError, match="channel_max has 3 values: one for each of 2 channels"):
        interview.parse("channel_max", "1 2 3")
    with pytest.raises(ConfigError, match="channel_min = 0 must be below channel_max = 0"):
        interview.parse("channel_max", "1 0")


def test_the_field_theta_is_proposed_also_where_it_is_an_array(monkeypatch):
    """Failed before: of a ControlInput, whose theta is one since it has knobs, it was epsilon."""
    answer(monkeypatch, "\n")
    proposed = Interview(None, [])._ask_fields("/theta", "koop_msgs/msg/ControlInput")
    assert proposed == "/theta:theta[0]"
