"""Commands come from the packages that are installed, and every one of them is listed."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from koop_lab.cli.main import main, overview, parser, registered

ROOT = Path(__file__).parents[2]


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Another package is installed: it brings `hello` and adds to `bag`."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "another-1.0.dist-info").mkdir()
    (tmp_path / "another-1.0.dist-info/METADATA").write_text("Name: another\nVersion: 1.0\n")
    (tmp_path / "another-1.0.dist-info/entry_points.txt").write_text(
        "[koop.commands]\nhello = another_package:hello\nbag = another_package:to_bag\n"
        "mistake = another_package:mistake\nfault = another_package:fault\n"
        "tidy = another_package:tidy\n"
    )
    (tmp_path / "another_package.py").write_text(
        "import gc\n"
        "from koop_bag.cli import bag_commands\n"
        "import numpy\n"
        "from koop_core.errors import KoopError\n"
        "def raise_(error):\n"
        "    raise error\n"
        "def mistake(commands):\n"
        "    commands.add_parser('mistake').set_defaults(func=lambda a: raise_(KoopError('no')))\n"
        "def fault(commands):\n"
        "    product = lambda args: numpy.eye(2) @ numpy.eye(3)\n"
        "    commands.add_parser('fault').set_defaults(func=product)\n"
        "def hello(commands):\n"
        "    commands.add_parser('hello').set_defaults(func=lambda args: 7)\n"
        "def tidy(commands):\n"
        "    enabled = lambda args: 9 * gc.isenabled()\n"
        "    commands.add_parser('tidy').set_defaults(func=enabled)\n"
        "def to_bag(commands):\n"
        "    bag_commands(commands).add_parser('count').set_defaults(func=lambda args: 8)\n"
    )
    yield
    sys.modules.pop("another_package", None)


def test_every_command_is_listed_with_what_it_does():
    out = subprocess.run([ROOT / "koop", "--help"], capture_output=True, text=True, check=True)
    listed = re.findall(r"^  (\w+) .{20,}$", out.stdout, re.MULTILINE)
    of_the_script = re.findall(r"^    ([a-z]+)\)", (ROOT / "koop").read_text(), re.MULTILINE)
    assert {"test", "run", "setup"} <= set(of_the_script)
    assert set(registered()) | set(of_the_script) <= set(listed)
    assert overview() in out.stdout


@pytest.mark.parametrize("name", sorted(registered()))
def test_a_command_of_an_entry_point_is_there(name, capsys):
    with pytest.raises(SystemExit, match="0"):
        parser(name).parse_args([name, "--help"])
    assert len(capsys.readouterr().out.splitlines()) > 4


def test_another_package_brings_a_command_and_adds_to_one(package):
    assert main(["hello"]) == 7
    assert main(["bag", "count"]) == 8
    assert main(["bag", "info", "nowhere"]) == 2


def test_garbage_is_collected_while_a_command_runs(package, tmp_path):
    path = os.pathsep.join([str(tmp_path), os.environ["PYTHONPATH"]])
    words = [sys.executable, "-m", "koop_lab", "tidy"]
    assert subprocess.run(words, env=os.environ | {"PYTHONPATH": path}).returncode == 9


def test_what_a_user_can_mend_is_one_line_and_a_fault_of_ours_is_a_traceback(package, capsys):
    assert main(["mistake"]) == 2
    assert capsys.readouterr().err == "koop mistake: error: no\n"
    assert main(["fault"]) == 70
    error = capsys.readouterr().err
    assert "Traceback" in error
    assert "ValueError: matmul" in error
    assert "please report it" in error


def test_what_is_no_option_is_named_in_one_line(capsys):
    assert main(["simulate", "--plott", "run.png"]) == 2
    error = "koop simulate: error: unknown argument '--plott': did you mean '--plot'?\n"
    assert capsys.readouterr().err == error
    assert main(["bag", "info", "nowhere", "--zzz"]) == 2
    assert "koop bag info: error: unknown argument '--zzz': see koop bag" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("word", "message"),
    [("dem", "no command 'dem': did you mean 'demo'?"), ("--foo", "no option '--foo': see koop")],
)
def test_what_is_no_command_is_named(word, message, capsys):
    assert main([word]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("code", "heavy"),
    [
        ("overview()", "numpy"),
        ("parser('up')", "numba"),
        ("parser('demo')", "matplotlib"),
        ("parser('commission')", "scipy"),
    ],
)
def test_only_what_a_command_needs_is_loaded(code, heavy):
    program = (
        f"import sys; from koop_lab.cli.main import *; {code}; print({heavy!r} in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout == "False\n"
