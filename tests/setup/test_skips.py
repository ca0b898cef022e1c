"""A skip is a failure in continuous integration, unless it is on the list."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
CASES = """
import pytest

@pytest.fixture
def absent():
    pytest.skip("what the test needs is not there")

def test_by_a_fixture(absent): pass

@pytest.mark.skip(reason="by a mark")
def test_by_a_mark(): pass

@pytest.mark.xfail
def test_expected_to_fail(): assert False
"""
MODULE = """
import pytest
pytest.importorskip("a_module_that_does_not_exist")
"""


def run(folder: Path, allowed: str, **environment: str) -> tuple[int, str]:
    """Run three tests under the repository's conftest; return the exit code and the summary."""
    (folder / "tests").mkdir()
    shutil.copy(REPOSITORY / "conftest.py", folder)
    (folder / "tests/allowed_skips.txt").write_text(f"# comment\n\n{allowed}\n")
    (folder / "tests/test_cases.py").write_text(CASES)
    (folder / "tests/test_module.py").write_text(MODULE)
    inherited = {name: value for name, value in os.environ.items() if name != "CI"}
    inherited["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # a third of the time
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"],
        cwd=folder, env={**inherited, **environment}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    return done.returncode, done.stdout


def test_a_skip_passes_at_home(tmp_path: Path) -> None:
    code, out = run(tmp_path, "")
    assert code == 0, out
    assert "3 skipped, 1 xfailed" in out


def test_a_skip_fails_where_ci_is_set(tmp_path: Path) -> None:
    code, out = run(tmp_path, "tests/test_cases.py::*: only these", CI="true")
    assert code == 2, out
    assert "could not import 'a_module_that_does_not_exist'" in out
    assert "see allowed_skips.txt" in out


def test_only_what_is_on_the_list_may_be_skipped(tmp_path: Path) -> None:
    allowed = "tests/test_cases.py::test_by_a_fixture: why\ntests/test_module.py: why"
    code, out = run(tmp_path, allowed, CI="true")
    assert code == 1, out
    assert "ERROR tests/test_cases.py::test_by_a_mark" in out
    assert "by a mark" in out
    assert "2 skipped, 1 xfailed, 1 error" in out


def list_of_the_repository() -> list[str]:
    lines = (REPOSITORY / "tests/allowed_skips.txt").read_text().splitlines()
    return [line for line in lines if line and not line.startswith("#")]


@pytest.mark.parametrize("line", list_of_the_repository())
def test_every_entry_names_a_test_file_and_a_reason(line: str) -> None:
    pattern, _, reason = line.partition(": ")
    assert (REPOSITORY / pattern.split("::")[0]).is_file()
    assert len(reason.split()) > 3
