"""The entry script, with a stand-in for Python and colcon: nothing is installed or built."""

from __future__ import annotations

import os
import pwd
import shutil
import subprocess
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path

import pytest

HERE = Path(__file__).parent
REPOSITORY = HERE.parent.parent
# What koop needs of the system. No apt-get: a test must never install anything.
TOOLS = (
    "bash", "basename", "cat", "chmod", "comm", "cp", "dirname", "env", "find", "flock", "grep",
    "mkdir", "mv", "nproc", "readlink", "rm", "sed", "sha256sum", "sleep", "sort", "tail", "touch",
    "tr", "true", "uname", "xargs",
)  # fmt: skip
COMMANDS = "src/koop_lab/koop_lab/cli/commands.txt"  # shown by --help
# arguments for pytest if the user gives none
WHOLE = "--numprocesses auto --dist loadfile --no-loadscope-reorder"
ROS_VARIABLES = ("AMENT_PREFIX_PATH", "ROS_DISTRO", "PYTHONPATH", "LD_LIBRARY_PATH")


class Clone:
    """A clone of the repository, cut down to the script and two small packages."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "clone"
        self.tools = folder / "tools"
        self.calls_file = folder / "calls"
        for name in ("koop", "scripts", "requirements", COMMANDS):
            source, target = REPOSITORY / name, self.root / name
            target.parent.mkdir(parents=True, exist_ok=True)
            (shutil.copytree if source.is_dir() else shutil.copy)(source, target)
        for package in ("first", "second"):
            module = self.root / "src" / package / package / "module.py"
            module.parent.mkdir(parents=True)
            module.touch()
            (module.parent.parent / "package.xml").write_text(package)
            (module.parent.parent / "config").mkdir()
        (self.root / "ros2_ws").mkdir()
        (self.root / "ros2_ws/src").symlink_to("../src")

        self.tools.mkdir()
        for tool in TOOLS:
            (self.tools / tool).symlink_to(shutil.which(tool) or f"/missing/{tool}")
        for compiler in ("gcc", "g++"):
            self.add_tool(compiler, "exit 0")
        self.add_tool("id", 'echo "${FAKE_UID:-1000}"')
        shutil.copy(HERE / "fake_python", self.tools / "python3.11")
        shutil.copy(HERE / "fake_colcon", self.tools)

    def add_tool(self, name: str, script: str) -> None:
        path = self.tools / name
        path.write_text(f"#!/usr/bin/env bash\n{script}\n")
        path.chmod(0o755)

    def start(self, *arguments: str, **environment: str) -> subprocess.Popen[str]:
        environment = {"PATH": str(self.tools), "CALLS": str(self.calls_file), **environment}
        return subprocess.Popen(
            [self.root / "koop", *arguments],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def koop(self, *arguments: str, **environment: str) -> tuple[int, str, str]:
        """Return exit code, standard output and standard error."""
        process = self.start(*arguments, **environment)
        out, err = process.communicate(timeout=240)
        return process.returncode, out, err

    def calls(self) -> list[str]:
        """The costly calls since the last time this was asked."""
        if not self.calls_file.exists():
            return []
        calls = self.calls_file.read_text().splitlines()
        self.calls_file.unlink()
        return calls


@pytest.fixture
def clone(tmp_path: Path) -> Clone:
    return Clone(tmp_path)


@pytest.fixture
def ready(clone: Clone) -> Clone:
    code, _, err = clone.koop("setup")
    assert code == 0, err
    clone.calls()
    files = [clone.root / "requirements" / name for name in ("plants.txt", "store.txt")]
    plants = b"".join(file.read_bytes() for file in files)
    (clone.root / ".venv/koop.plants").write_text(f"{sha256(plants).hexdigest()}  -")
    return clone


def test_first_call_makes_the_environment_and_builds_every_package(clone: Clone) -> None:
    code, _, err = clone.koop("setup")
    assert code == 0
    assert "koop: the first call sets up " in err
    venv, pip, colcon = clone.calls()
    assert venv.startswith("-m venv")
    assert "--no-deps" in pip
    assert "ros-jazzy.txt" in pip
    assert "--packages-select first second " in colcon


def test_second_call_runs_neither_pip_nor_colcon(ready: Clone) -> None:
    assert ready.koop("shell", "-c", "echo hello") == (0, "hello\n", "")
    assert ready.calls() == []


def test_help_sets_nothing_up(clone: Clone) -> None:
    code, out, _ = clone.koop("--help")
    assert code == 0
    assert out.startswith("usage: ./koop COMMAND")
    assert (REPOSITORY / COMMANDS).read_text() in out
    assert not (clone.root / ".venv").exists()


def test_alone_it_says_where_the_checkout_stands_and_sets_nothing_up(clone: Clone) -> None:
    (clone.root / "recordings/golden").mkdir(parents=True)
    code, out, _ = clone.koop()
    assert code == 0
    assert "set up        not yet" in out
    assert "last recorded nothing yet" in out
    assert not (clone.root / ".venv").exists()
    assert clone.koop("setup")[0] == 0
    (clone.root / "recordings/20260101-demo").mkdir()
    out = clone.koop()[1]
    assert "set up        on the ROS 2 of .venv" in out
    assert "last recorded recordings/20260101-demo" in out


@pytest.mark.parametrize(
    ("typed", "offered"),
    [("comm", ["commission"]), ("she", ["shell"]), ("demo --du", ["--duration"]), ("up x", [])],
)
def test_the_tab_key_completes_commands_and_their_options(typed: str, offered: list[str]) -> None:
    script = f"""source scripts/completion.bash
    COMP_WORDS=(./koop {typed}) COMP_CWORD={len(typed.split())}
    _koop; printf '%s\\n' "${{COMPREPLY[@]}}" """
    done = subprocess.run(
        ["bash", "-c", script], cwd=REPOSITORY, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == offered


def test_other_commands_go_to_koop_lab_with_their_arguments(ready: Clone) -> None:
    assert ready.koop("demo", "--seed", "4")[1] == "python -m koop_lab demo --seed 4\n"


def test_include_paths_of_the_build_machine_are_replaced(ready: Clone) -> None:
    assert (ready.root / ".venv/share/export.cmake").read_text().splitlines() == [
        '"/fake/include/python3.11;/kept"',
        '"/fake/numpy/_core/include"',
    ]


def test_failed_step_shows_its_last_lines_and_the_next_call_goes_on_there(
    clone: Clone, tmp_path: Path
) -> None:
    broken = tmp_path / "broken"
    broken.touch()
    code, _, err = clone.koop("setup", FAIL_PIP=str(broken))
    assert code == 1
    assert "pip's last words" in err
    assert str(clone.root / "ros2_ws/log/koop-setup.log") in err
    clone.calls()

    broken.unlink()
    assert clone.koop("setup", FAIL_PIP=str(broken))[0] == 0
    assert [call.split()[1] for call in clone.calls()] == ["uv", "build"]


def test_changed_pins_are_installed_without_a_new_environment_or_build(ready: Clone) -> None:
    with (ready.root / "requirements/python.txt").open("a") as file:
        file.write("# changed\n")
    code, _, err = ready.koop("setup")
    assert code == 0
    assert "the first call" not in err
    (pip,) = ready.calls()
    assert pip.startswith("-m uv pip install")


def test_changed_pins_keep_the_python_of_the_environment_whichever_is_first_on_the_path(
    ready: Clone,
) -> None:
    shutil.copy(HERE / "fake_python", ready.tools / "python3.12")  # would be chosen first
    with (ready.root / "requirements/python.txt").open("a") as file:
        file.write("# changed\n")
    assert ready.koop("setup")[0] == 0
    (pip,) = ready.calls()
    assert pip.startswith("-m uv pip install")
    chosen = str(ready.tools / "python3.12")
    assert ready.koop("setup", KOOP_PYTHON=chosen)[0] == 0
    assert [call.split()[1] for call in ready.calls()] == ["venv", "uv", "build"]


def test_changed_ros_wheels_make_a_new_environment_and_build(ready: Clone) -> None:
    with (ready.root / "requirements/ros-jazzy.txt").open("a") as file:
        file.write("# changed\n")
    assert ready.koop("setup")[0] == 0
    assert [call.split()[1] for call in ready.calls()] == ["venv", "uv", "build"]


def test_moved_clone_is_set_up_again(ready: Clone) -> None:
    ready.root = ready.root.rename(ready.root.with_name("moved"))
    assert ready.koop("setup")[0] == 0
    assert [call.split()[1] for call in ready.calls()] == ["venv", "uv", "build"]


def test_edited_module_needs_no_build(ready: Clone) -> None:
    (ready.root / "src/first/first/module.py").write_text("changed")
    assert ready.koop("setup")[0] == 0
    assert ready.calls() == []


def test_edited_package_file_builds_that_package_only(ready: Clone) -> None:
    (ready.root / "src/second/package.xml").write_text("changed")
    assert ready.koop("setup")[0] == 0
    (colcon,) = ready.calls()
    assert "--packages-select second " in colcon


def test_data_file_is_linked_once_and_then_free_to_edit(ready: Clone) -> None:
    data = ready.root / "src/first/config/first.yaml"
    data.touch()
    assert ready.koop("setup")[0] == 0
    (colcon,) = ready.calls()
    assert "--packages-select first " in colcon
    data.write_text("changed")
    assert ready.koop("setup")[0] == 0
    assert ready.calls() == []


def test_removed_package_leaves_nothing_behind(ready: Clone) -> None:
    shutil.rmtree(ready.root / "src/second")
    assert ready.koop("setup")[0] == 0
    assert ready.calls() == []
    assert not (ready.root / "ros2_ws/install/second").exists()
    assert ready.koop("run", "second", "tell")[0] == 2


def test_concurrent_calls_set_up_once(clone: Clone) -> None:
    processes = [clone.start("shell", "-c", "true", SLOW_PIP="1") for _ in range(3)]
    errors = [process.communicate(timeout=240)[1] for process in processes]
    assert [process.returncode for process in processes] == [0, 0, 0], errors
    assert [call.split()[1] for call in clone.calls()] == ["venv", "uv", "build"]


def test_run_passes_arguments_and_exit_code(ready: Clone) -> None:
    code, out, _ = ready.koop("run", "first", "tell", "two words", "--ros-args", "")
    assert (code, out) == (7, "<two words><--ros-args><>")


@pytest.mark.parametrize("arguments", [(), ("first",), ("absent", "tell"), ("first", "absent")])
def test_run_of_something_unknown_lists_what_there_is(
    ready: Clone, arguments: tuple[str, ...]
) -> None:
    code, out, err = ready.koop("run", *arguments)
    assert (code, out) == (2, "")
    assert "  first tell\n" in err


def test_other_machines_are_left_alone_unless_the_user_says_otherwise(ready: Clone) -> None:
    shell = "echo $ROS_AUTOMATIC_DISCOVERY_RANGE"
    assert ready.koop("shell", "-c", shell)[1] == "LOCALHOST\n"
    assert ready.koop("shell", "-c", shell, ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET")[1] == "SUBNET\n"


def test_idle_threads_sleep_soon_unless_the_user_says_otherwise(ready: Clone) -> None:
    shell = "echo $OPENBLAS_THREAD_TIMEOUT"
    assert ready.koop("shell", "-c", shell)[1] == "20\n"
    assert ready.koop("shell", "-c", shell, OPENBLAS_THREAD_TIMEOUT="26")[1] == "26\n"


def test_tests_get_their_arguments_and_the_browser_that_is_there(ready: Clone) -> None:
    (ready.root / ".venv/bin/python").write_text('#!/bin/sh\necho "$CHROMIUM $*"\n')
    ready.add_tool("chromium", "")
    ready.add_tool("google-chrome", "")
    code, out, err = ready.koop("test", "-k", "x", CI="true")
    assert (code, out, err) == (0, f"{ready.tools}/chromium -m pytest -k x\n", "")


@pytest.mark.parametrize(
    "with_pip", [{"FAIL_UV": "1"}, {"PIP_CONFIG": "global.index-url='https://mirror.example'"}]
)
def test_pip_installs_where_uv_cannot_be_had_or_would_pass_an_index_by(
    clone: Clone, with_pip: dict[str, str]
) -> None:
    assert clone.koop("setup", **with_pip)[0] == 0
    (call,) = (call for call in clone.calls() if "requirements/python.txt" in call)
    assert call.startswith("-m pip install")


def test_tests_install_the_plants_that_they_need_once_and_fail_only_where_they_must(
    ready: Clone,
) -> None:
    ready.add_tool("chromium", "")
    (ready.root / ".venv/koop.plants").unlink()
    fails = {"FAIL_PIP": str(ready.root)}  # which is there
    code, out, err = ready.koop("test", **fails)
    assert (code, out) == (0, f"python -m pytest {WHOLE}\n")
    assert err.endswith(
        "the tests that fly an aircraft, run an FMU or read from an object store are skipped\n"
    )
    code, out, err = ready.koop("test", CI="true", **fails)
    assert (code, out) == (1, "")
    assert "pip's last words" in err
    ready.calls()
    assert ready.koop("test")[:2] == (0, f"python -m pytest {WHOLE}\n")
    (call,) = ready.calls()
    assert call.endswith(
        "--no-deps "
        + " ".join(f"-r {ready.root}/requirements/{n}.txt" for n in ("plants", "store"))
    )
    assert ready.koop("test")[::2] == (0, "")
    assert ready.calls() == []


INSTALLS_A_BROWSER = """
echo "apt-get $*" >>"$CALLS"
[[ $1 == update ]] || cp "$0" "$(dirname "$0")/chromium"
"""


@pytest.mark.parametrize("sudo", [False, True])
def test_tests_install_a_browser_where_they_may(ready: Clone, sudo: bool) -> None:
    (ready.root / ".venv/bin/python").write_text('#!/bin/sh\necho "$CHROMIUM $*"\n')
    ready.add_tool("apt-get", INSTALLS_A_BROWSER)
    if sudo:
        ready.add_tool("sudo", 'shift; exec "$@"')
    code, out, err = ready.koop("test", FAKE_UID="1000" if sudo else "0")
    assert (code, out) == (0, f"{ready.tools}/chromium -m pytest {WHOLE}\n"), err
    assert ready.calls() == [
        "apt-get update",
        "apt-get install -y --no-install-recommends chromium",
    ]


def test_without_root_the_line_that_installs_a_browser_is_printed(ready: Clone) -> None:
    ready.add_tool("apt-get", "exit 9")
    code, out, err = ready.koop("test")
    assert (code, out) == (0, f"python -m pytest {WHOLE}\n")
    line = "apt-get install -y --no-install-recommends chromium\n"
    assert line in err
    code, out, err = ready.koop("test", CI="true")
    assert (code, out) == (3, "")
    assert line in err


def test_a_browser_that_cannot_be_installed_fails_only_where_it_must(ready: Clone) -> None:
    ready.add_tool("apt-get", "echo no network; exit 9")
    assert ready.koop("test", FAKE_UID="0")[:2] == (0, f"python -m pytest {WHOLE}\n")
    code, out, err = ready.koop("test", FAKE_UID="0", CI="true")
    assert (code, out) == (1, "")
    assert "no network" in err


@pytest.mark.parametrize(
    ("compiler", "package"), [("g++", "g++"), ("gcc", "gcc")], ids=["c++", "c"]
)
def test_missing_compiler_is_named_where_it_cannot_be_installed(
    clone: Clone, compiler: str, package: str
) -> None:
    (clone.tools / compiler).unlink()
    code, _, err = clone.koop("setup")
    assert code == 3
    assert f"missing: {package} " in err


def test_missing_headers_are_named_by_the_interpreters_version(clone: Clone) -> None:
    code, _, err = clone.koop("setup", FAKE_HAS="1 0")
    assert code == 3
    assert "missing: python3.11-dev " in err


def test_without_root_the_exact_command_is_printed(clone: Clone) -> None:
    clone.add_tool("apt-get", "exit 9")
    (clone.tools / "g++").unlink()
    code, _, err = clone.koop("setup")
    assert code == 3
    assert "apt-get install -y --no-install-recommends g++\n" in err


def test_as_root_what_is_missing_is_installed(clone: Clone) -> None:
    clone.add_tool("apt-get", 'echo "apt-get $*" >>"$CALLS"')
    (clone.tools / "g++").unlink()
    assert clone.koop("setup", FAKE_UID="0")[0] == 0
    assert clone.calls()[:2] == [
        "apt-get update",
        "apt-get install -y --no-install-recommends g++",
    ]


def test_place_that_colcon_cannot_handle_is_refused(clone: Clone) -> None:
    clone.root = clone.root.rename(clone.root.with_name("a clone"))
    code, _, err = clone.koop("setup")
    assert code == 4
    assert "move the clone" in err
    assert clone.calls() == []


def test_unsupported_python_is_refused(clone: Clone) -> None:
    clone.add_tool("python2", "exit 1")
    code, _, err = clone.koop("setup", KOOP_PYTHON="python2")
    assert code == 4
    assert "KOOP_PYTHON=python2 is not a Python 3.10 to 3.13" in err


def sourced(jazzy: Path, *overlays: Path) -> dict[str, str]:
    """Return the environment of a shell with a ROS 2 Jazzy and overlays sourced."""
    for prefix, package in ((jazzy, "rclpy"), *((overlay, overlay.name) for overlay in overlays)):
        index = prefix / "share/ament_index/resource_index/packages"
        index.mkdir(parents=True, exist_ok=True)
        (index / package).touch()
    path = ":".join(str(prefix) for prefix in (*overlays, jazzy))
    return {"ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": path, "PYTHONPATH": f"{jazzy}/lib/python"}


def test_sourced_jazzy_takes_the_place_of_the_wheels(clone: Clone, tmp_path: Path) -> None:
    jazzy = tmp_path / "jazzy"
    again = f'{clone.root}/koop setup && echo "$AMENT_PREFIX_PATH"'
    code, out, err = clone.koop("shell", "-c", again, **sourced(jazzy), FAKE_RCLPY="1")
    assert code == 0, err
    # The inner call, from within the sourced workspace, found everything made.
    venv, pip, _ = clone.calls()
    assert "--system-site-packages" in venv
    assert "ros-jazzy.txt" not in pip
    assert out.endswith(f"/install/first:{jazzy}\n")


def test_one_more_overlay_changes_nothing_and_is_seen(clone: Clone, tmp_path: Path) -> None:
    jazzy, overlay = tmp_path / "jazzy", tmp_path / "overlay"
    assert clone.koop("setup", **sourced(jazzy), FAKE_RCLPY="1")[0] == 0
    clone.calls()
    environment = sourced(jazzy, overlay)
    show = 'echo "$AMENT_PREFIX_PATH $PYTHONPATH"'
    twice = f"{show}; {clone.root}/koop shell -c '{show}'"
    code, out, err = clone.koop("shell", "-c", twice, **environment, FAKE_RCLPY="1")
    assert (code, err) == (0, "")
    assert clone.calls() == []
    outer, inner = out.splitlines()
    assert outer.endswith(f"/install/first:{overlay}:{jazzy} {jazzy}/lib/python")
    assert inner == outer


def test_another_rclpy_makes_another_environment(clone: Clone, tmp_path: Path) -> None:
    assert clone.koop("setup", **sourced(tmp_path / "jazzy"), FAKE_RCLPY="1")[0] == 0
    clone.calls()
    assert clone.koop("setup", **sourced(tmp_path / "another"), FAKE_RCLPY="1")[0] == 0
    assert [call.split()[1] for call in clone.calls()] == ["venv", "uv", "build"]


@pytest.fixture
def user(ready: Clone) -> Iterator[subprocess.Popen[bytes]]:
    """A process that runs from the environment, not started by koop."""
    program = ready.root / ".venv/bin/program"
    shutil.copy(shutil.which("sleep") or "", program)
    process = subprocess.Popen([program, "60"])
    yield process
    process.kill()
    process.wait()


@pytest.mark.parametrize("pins", ["ros-jazzy.txt", "python.txt"])
def test_an_environment_in_use_is_not_replaced(
    ready: Clone, user: subprocess.Popen[bytes], pins: str
) -> None:
    assert ready.koop("shell", "-c", "true") == (0, "", "")
    with (ready.root / "requirements" / pins).open("a") as file:
        file.write("# changed\n")
    code, _, err = ready.koop("shell", "-c", "true")
    assert code == 5
    assert f" {user.pid}  {ready.root}/.venv/bin/program 60\n" in err
    assert ready.calls() == []
    user.kill()
    user.wait()
    assert ready.koop("shell", "-c", "true")[0] == 0
    assert ready.calls() != []


def test_an_environment_in_use_is_not_removed(ready: Clone, user: subprocess.Popen[bytes]) -> None:
    assert ready.koop("setup", "--clean")[0] == 5
    user.kill()
    user.wait()
    assert ready.koop("setup", "--clean")[0] == 0
    assert not (ready.root / ".venv").exists()


def test_sourced_jazzy_without_a_fitting_python_gives_way_to_the_wheels(
    clone: Clone, tmp_path: Path
) -> None:
    environment = sourced(tmp_path / "jazzy")
    code, out, err = clone.koop("shell", "-c", 'echo "$AMENT_PREFIX_PATH"', **environment)
    assert code == 0, err
    assert "no Python here can import its rclpy" in err
    assert "ros-jazzy.txt" in clone.calls()[1]
    assert str(tmp_path / "jazzy") not in out
    clone.koop("setup", **environment)
    assert clone.calls() == []


def test_other_distribution_is_named_and_does_not_leak_in(clone: Clone) -> None:
    sourced = dict.fromkeys(ROS_VARIABLES, "/opt/ros/humble") | {"ROS_DISTRO": "humble"}
    code, out, err = clone.koop("shell", "-c", "env", **sourced)
    assert code == 0, err
    assert "ROS 2 humble is sourced, not jazzy" in err
    assert "/opt/ros" not in out
    assert "ros-jazzy.txt" in clone.calls()[1]


@pytest.mark.parametrize("by", ["KOOP_ROS", "ROS_DISTRO"])
def test_another_ros_that_is_tried_is_asked_for_or_sourced(ready: Clone, by: str) -> None:
    code, out, err = ready.koop("shell", "-c", "echo $ROS_DISTRO", **{by: "kilted"})
    assert (code, out) == (0, "kilted\n"), err
    venv, pip, *_ = ready.calls()
    assert venv.startswith("-m venv")  # nothing of Jazzy stays
    assert "ros-kilted.txt" in pip


def test_a_ros_that_is_not_tried_is_refused(ready: Clone) -> None:
    code, out, err = ready.koop("setup", KOOP_ROS="humble")
    assert (code, out, err) == (2, "", "koop: KOOP_ROS=humble is none of jazzy kilted\n")


def test_an_edited_source_drops_the_compiled_kernels_of_all_that_may_call_it(ready: Clone) -> None:
    source = ready.root / "src"
    for package, needs in (("third", "second"), ("fourth", "third"), ("fifth", "first")):
        (source / package).mkdir()
        (source / package / "package.xml").write_text(f"<exec_depend>{needs}</exec_depend>")
    kernels = {}
    for package in ("first", "second", "third", "fourth", "fifth"):
        kernels[package] = source / package / package / "__pycache__" / "module.kernel.nbc"
        kernels[package].parent.mkdir(parents=True, exist_ok=True)
        kernels[package].touch()
    assert ready.koop("shell", "-c", "true")[0] == 0
    assert all(kernel.exists() for kernel in kernels.values())
    edited = source / "second/second/module.py"
    stamp = (ready.root / "ros2_ws/install/koop_kernels.stamp").stat().st_mtime
    edited.write_text("edited")
    os.utime(edited, (stamp + 1, stamp + 1))
    assert ready.koop("shell", "-c", "true")[0] == 0
    assert {name for name, kernel in kernels.items() if kernel.exists()} == {"first", "fifth"}


def test_an_empty_environment_has_a_home_where_ros_2_keeps_its_logs(ready: Clone) -> None:
    code, out, err = ready.koop("shell", "-c", 'echo "$HOME"')
    assert (code, err) == (0, "")
    assert out.strip() == pwd.getpwuid(os.getuid()).pw_dir
    assert ready.koop("shell", "-c", 'echo "$HOME"', HOME="/elsewhere")[1].strip() == "/elsewhere"
