"""Which parameters of a file are for all nodes, and which were meant for one."""

import pytest

from koop_core.config.parameter import ConfigError
from koop_core.config.parameter_file import shared_names

NODE = "/rig/relay_esc"


@pytest.fixture
def file(tmp_path):
    def write(text, name="params.yaml"):
        (tmp_path / name).write_text(text)
        return ["--ros-args", "--params-file", str(tmp_path / name)]

    return write


@pytest.mark.parametrize("section", ["/**", "/*", "/rig/**", "/rig: {'**'"])
def test_what_stands_under_a_wildcard_only_is_shared(file, section):
    end = "}" if "{" in section else ""
    args = file(f"{section}: {{ros__parameters: {{robot_description: x, a: {{b: 1}}}}}}{end}")
    assert shared_names(args, NODE) == {"robot_description", "a.b"}


@pytest.mark.parametrize(
    "section", ["rig/relay_esc", "/*/relay_esc", "/rig/relay_esc", "/**/relay_esc"]
)
def test_what_is_given_to_a_node_by_its_name_is_not(file, section):
    args = file(f"/**: {{ros__parameters: {{dampening: 1.0}}}}\n{section}: {{ros__parameters: "
                "{dampening: 2.0}}")  # fmt: skip
    assert shared_names(args, NODE) == set()


def test_what_is_given_on_the_command_line_is_meant_for_the_node(file):
    args = file("/**: {ros__parameters: {a: 1, b: 2, c: 3}}")
    assert shared_names([*args, "-p", "a:=2", "--param", "relay_esc:b:=2"], NODE) == {"c"}
    assert shared_names([*args[1:]], NODE) == set()  # not within --ros-args
    assert shared_names([*args[:1], "--", *args[1:]], NODE) == set()


@pytest.mark.parametrize("text", ["[", "3", "a: 1", "/**: {ros__parameters: 3}", "\x00"])
def test_a_file_that_means_nothing_is_refused(file, text):
    with pytest.raises(ConfigError):
        shared_names(file(text), NODE)


def test_unknown_names_are_refused_unless_shared():
    from koop_node.node.parameters import refuse_unmeant

    refuse_unmeant(["robot_description"], ["dwell"], {"robot_description"})
    with pytest.raises(ConfigError, match="unknown parameter 'dampening': known are dwell"):
        refuse_unmeant(["dampening", "robot_description"], ["dwell"], {"robot_description"})
