"""What the documentation tells a user to type exists, its links lead somewhere, and it is short."""

import re
import runpy
import shlex
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix

from koop_bringup.plan import plan, refuse_other_arguments
from koop_lab.cli.main import main, parser
from koop_loop.parameters import NODES

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
REFERENCE = runpy.run_path(str(ROOT / "scripts" / "reference.py"))
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), ROOT / "recordings/README.md"])
HISTORY = {"decisions", "CHANGELOG.md"}  # name what was, too
OF_THE_SCRIPT = {"test", "run", "shell", "docs", "setup"}
MOST = {"commands": 30, "options": 140, "parameters": 35}
MOST_LINES = {"docs": 1600, "README.md": 120}
WIDTH = 100

each_page = pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))


def typed(path, program):
    """Return what a page tells to type, from its blocks and code spans."""
    text = path.read_text().replace("\\\n", " ")
    actual = re.findall(rf"`({program} [^`]+)`", text) + re.findall(
        rf"^ *({program} .*)$", text, re.M
    )
    return sorted({" ".join(line.split("#")[0].split()) for line in actual})


def test_the_readme_begins_with_the_two_commands():
    block = README.read_text().split("```")[1]
    assert block.split()[:3] == ["sh", "./koop", "demo"]
    assert "./koop test" in block


@each_page
def test_a_koop_command_is_understood(path):
    for line in typed(path, r"\./koop") if HISTORY.isdisjoint(path.parts) else ():
        words = shlex.split(line)[1:]
        if words[0] == "run" and words[1].islower():
            assert_executable(words[1], words[2])
        elif words[0] not in OF_THE_SCRIPT | {"COMMAND", "--help"}:
            assert parser(words[0]).parse_args(words).func, line


@pytest.mark.parametrize("line", typed(README, "ros2"))
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


@each_page
def test_a_link_leads_somewhere(path):
    for link in re.findall(r"\]\(([^)\s]+)\)", path.read_text()):
        target, _, anchor = link.partition("#")
        if "://" not in link:
            page = path.parent / target if target else path
            assert page.exists(), link
            assert not anchor or anchor in anchors(page), link


def anchors(page):
    """Return the anchors of a page's headings, as GitHub makes them."""
    titles = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("path", sorted(REFERENCE["PAGES"]), ids=lambda path: path.name)
def test_the_reference_is_generated_from_the_code(path):
    hint = "run: ./koop shell -c 'python scripts/reference.py'"
    assert path.read_text() == REFERENCE["PAGES"][path](), hint


def test_the_surface_stays_small():
    counts = REFERENCE["counts"]()
    assert {name for name, most in MOST.items() if counts[name] > most} == set(), counts


@each_page
def test_no_line_of_the_documentation_is_wider_than_the_page(path):
    if "docs" in path.relative_to(ROOT).parts or path.name in ("README.md", "CHANGELOG.md"):
        assert [line for line in path.read_text().splitlines() if len(line) > WIDTH] == []


@pytest.mark.parametrize("name", MOST_LINES)
def test_the_documentation_stays_short(name):
    pages = [path for path in PAGES if path.relative_to(ROOT).parts[0] == name]
    assert sum(len(path.read_text().splitlines()) for path in pages) <= MOST_LINES[name]


def test_the_cheap_commands_do_what_the_readme_says(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "--plot", "run.png"]) == 0
    assert (tmp_path / "run.png").is_file()
    assert main(["inspect"]) == 0
    assert "0.999298 + 0.000000j" in capsys.readouterr().out
