"""The rig file: what is written is read, and what cannot be meant is refused with its line."""

import pytest

from koop_core.config.parameter import ConfigError
from koop_tune.rig import rig_file
from koop_tune.rig.rig_file import RigFile, read, written

RIG = RigFile(
    measured="/tower:data[0],data[1]",
    command="/tower/stiffness:data",
    dt=0.01,
    theta_min=0.5,
    theta_max=1.6,
    theta_rate=0.05,
    theta_start=1.0,
    theta_safe=0.9,
    channel_min=(-3.0, -1e-3),
    channel_max=(3.0, 2e-3),
    objective="maximise",
    time=600.0,
)


def test_what_is_written_is_read_again(tmp_path):
    rig_file.write(RIG, tmp_path / "rig.yaml")
    assert read(tmp_path / "rig.yaml") == RIG
    with pytest.raises(ConfigError, match="is there already"):
        rig_file.write(RIG, tmp_path / "rig.yaml")


def test_every_value_has_its_meaning_above_it():
    lines = written(RIG).splitlines()
    for i, line in enumerate(lines):
        if line and not line.startswith("#"):
            assert lines[i - 1].startswith("# "), line


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "theta_min: 0.5",
            "theta_min: 5",
            r":17: theta_min = 5 must be below theta_max = 1.6: are",
        ),
        ("theta_safe: 0.9", "theta_safe: 9", r"theta_safe = 9: must lie within .* \[0.5, 1.6\]"),
        ("theta_rate: 0.05", "", "'theta_rate' is missing: largest change of theta per second"),
        ("theta_rate:", "theta_rte:", r":\d+: unknown key 'theta_rte': did you mean 'theta_rate'"),
        (
            "theta_safe: 0.9",
            "theta_safe: [0.9, 1]",
            r":\d+: theta_safe has 2 values: the command has",
        ),
        ("dt: 0.01", "dt: fast", r":\d+: dt: expected float, got 'fast'"),
        ("dt: 0.01", "dt: 0.01\ndt: 0.02", "'dt' stands in line 1"),
        ("data[0],data[1]", "data[0,data[1]", r":\d+: measured: 'data\[0' is not a field"),
        ("/stiffness:data", "/stiffness", r":\d+: command: .* is not a source"),
        ("/tower/stiffness:data", "/tower:data[2]", "command .* is the topic of the measured"),
        (
            "channel_min: [-3.0, -0.001]",
            "channel_min: [-3.0]",
            r"channel_min has 1 values: one for",
        ),
        ("[-3.0, -0.001]", "[4.0, -0.001]", r":\d+: channel_min = 4 must be below channel_max = 3"),
        ("objective: maximise", "objective: more", r":\d+: objective = 'more': must be one of"),
        ("objective: maximise", "objective: [", r"cannot be read as YAML.*line \d+"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_its_line(tmp_path, old, new, message):
    text = written(RIG)
    assert old in text
    path = tmp_path / "rig.yaml"
    path.write_text(text.replace(old, new))
    with pytest.raises(ConfigError, match=rf"rig\.yaml.*{message}"):
        read(path)


def test_a_signals_bound_is_refused_for_several_knobs_and_lines_between_them_are_not(tmp_path):
    path = tmp_path / "rig.yaml"
    text = written(RIG).replace("/stiffness:data", "/gains:data[0],data[1]")
    line, bound = "theta[0] <= 2 theta[1]", "rms(/tower/effort:data, 10 s) < 1.5"
    path.write_text(text.replace("constraint: ''", f"constraint: {line}"))
    assert read(path).lines[0].weights == (1.0, -2.0)
    for constraint in (bound, f"{line}; {bound}"):
        path.write_text(text.replace("constraint: ''", f"constraint: {constraint}"))
        with pytest.raises(ConfigError, match=r"rig\.yaml:\d+: constraint = .* of one knob only"):
            read(path)


def test_all_that_is_missing_is_told_at_once(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text("dt: 0.01\ntheta_min: 0.0\n")
    with pytest.raises(ConfigError, match=r"missing: measured, .*, theta_safe; koop commission"):
        read(path)


def test_a_number_is_one_in_any_spelling(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(written(RIG).replace("dt: 0.01", "dt: 1e-2"))
    assert read(path).dt == 0.01


def test_a_topic_is_the_same_with_and_without_a_slash(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(written(RIG).replace("measured: /tower", "measured: tower"))
    assert read(path).measured_source == RIG.measured_source
