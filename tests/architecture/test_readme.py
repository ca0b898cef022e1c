"""What the README tells a user to type exists."""

import re
import shlex
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix

from koop_bringup.plan import plan, refuse_other_arguments
from koop_lab.cli.main import main, parser
from koop_loop.parameters import NODES

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
# commands stand in fenced blocks and in code spans
CODE = re.findall(r"```sh\n(.*?)```", README, re.DOTALL) + re.findall(r"`([^`\n]+)`", README)
LINES = sorted({line.split("#")[0].strip() for block in CODE for line in block.splitlines()})
KOOP = [line for line in LINES if line.startswith("./koop ")]
ROS2 = [line for line in LINES if re.match(r"ros2 \S+ \S", line)]
OF_THE_SCRIPT = {"test", "run", "shell", "setup", "clean", "--help"}


def test_the_readme_begins_with_the_two_commands():
    assert README.split("```")[1].split()[:3] == ["sh", "./koop", "demo"]
    assert "./koop test" in README.split("```")[1]


@pytest.mark.parametrize("line", KOOP)
def test_a_koop_command_is_understood(line):
    words = shlex.split(line)[1:]
    script = (ROOT / "koop").read_text()
    if words[0] in OF_THE_SCRIPT:
        assert words[0] in script
        if words[0] == "run" and len(words) > 2:
            assert_executable(words[1], words[2])
    elif "--help" in words:
        with pytest.raises(SystemExit, match="0"):
            parser().parse_args(words)
    else:
        assert parser().parse_args(words).func


@pytest.mark.parametrize("line", ROS2)
def test_a_ros2_command_names_what_exists(line):
    words = shlex.split(line)
    if words[1] == "run":
        assert_executable(words[2], words[3])
    if words[1:3] == ["launch", "koop_bringup"]:
        assert (ROOT / "src/koop_bringup/launch" / words[3]).is_file()
        refuse_other_arguments(words[4:])
        plan(dict(word.split(":=", 1) for word in words[4:]))
    if words[1] in ("param", "lifecycle", "service"):
        node = words[3].split("/")[1]
        assert node in NODES
        if words[1] == "param":
            names = {name for cls in NODES[node] for name in cls.__dataclass_fields__}
            assert words[4] in names


def assert_executable(package, name):
    assert (Path(get_package_prefix(package)) / "lib" / package / name).is_file()


def test_links_inside_the_repository_lead_somewhere():
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        if "://" not in target:
            assert (ROOT / target).exists(), target


def test_the_cheap_commands_do_what_the_readme_says(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "--out", "run.npz", "--plot", "run.png"]) == 0
    assert {"run.npz", "run.png"} <= {path.name for path in tmp_path.iterdir()}
    assert main(["inspect"]) == 0
    assert "0.999298 + 0.000000j" in capsys.readouterr().out
