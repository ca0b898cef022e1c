"""``koop up --install``: a unit that systemd takes, with no rights that it does not need."""

import os
import pwd
import re
import shlex
import shutil
import subprocess
from configparser import ConfigParser
from pathlib import Path

import pytest

from koop_lab.cli.main import main

PARAMETERS = """
/relay_esc: {ros__parameters: {priority: 40}}
/koop_guard:
  ros__parameters: {command: "/rig/theta:data", theta_min: -5.0, theta_max: 5.0, theta_rate: 0.5,
                    note: NOTE}
"""
USER, SYSTEM = 1000, 0


@pytest.fixture
def install(tmp_path, monkeypatch, capsys):
    """Install a loop as root or another user; return the unit, its file and what was printed."""

    def install(user, *options):
        monkeypatch.setattr(os, "geteuid", lambda: user)
        monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
        monkeypatch.setattr("koop_bringup.service.SYSTEM_UNITS", tmp_path / "system")
        monkeypatch.setenv("ROS_DOMAIN_ID", "7")
        monkeypatch.chdir(tmp_path)
        folder = tmp_path / "100 % mine"
        folder.mkdir(exist_ok=True)
        note = tmp_path / "rigs" / ".rig.yaml.theta"
        note.parent.mkdir(exist_ok=True)
        (folder / "controller.yaml").write_text(PARAMETERS.replace("NOTE", str(note)))
        assert main(["up", folder.name, "--install", *options]) == 0
        printed = capsys.readouterr().out
        path = re.search(r"written: (.*); next:", printed)[1]
        unit = ConfigParser(strict=False, interpolation=None)
        unit.optionxform = str
        unit.read(path)
        return unit, path, printed

    return install


@pytest.mark.parametrize("user", [USER, SYSTEM])
def test_the_unit_starts_the_loop_as_it_was_described(install, tmp_path, user):
    unit, path, printed = install(user, "--composed", "--serve", "0")
    service = unit["Service"]
    words = shlex.split(service["ExecStart"].replace("%%", "%"))
    assert words == [
        f"{os.environ['KOOP_ROOT']}/koop", "up", f"{tmp_path}/100 % mine", "--composed",
        "--serve=0",
    ]  # fmt: skip
    assert service["WorkingDirectory"] == str(tmp_path)
    assert '"ROS_DOMAIN_ID=7"' in Path(path).read_text()
    assert (service["Type"], service["Restart"]) == ("notify", "on-failure")
    assert service["KillMode"] == "process"  # guard and twin are not killed with koop up
    # 10 / 0.5 = 20 s that theta may take to return, and 10 s for a node to end
    assert float(service["TimeoutStopSec"]) > 30.0
    assert float(service["RestartSec"]) >= 20.0
    writable = shlex.split(service["ReadWritePaths"].replace("%%", "%"))
    assert {f"{tmp_path}/recordings", f"{tmp_path}/rigs"} <= set(writable)
    assert (service["NoNewPrivileges"], service["ProtectSystem"]) == ("yes", "strict")
    assert service["LimitRTPRIO"] == "40"
    name = "koop-100---mine.service"
    ctl = "systemctl" if user == SYSTEM else "systemctl --user"
    assert f"  {ctl} enable --now {name}\n" in printed
    assert ("loginctl enable-linger" in printed) == (user != SYSTEM)
    if user == SYSTEM:
        assert path == f"{tmp_path}/system/{name}"
        assert unit["Unit"]["After"] == "network-online.target"
        assert service["CapabilityBoundingSet"] == ""
        assert service["User"] == pwd.getpwuid(os.stat(tmp_path).st_uid).pw_name
    else:
        assert path == f"{tmp_path}/config/systemd/user/{name}"
    if shutil.which("systemd-analyze"):
        mode = [] if user == SYSTEM else ["--user"]
        done = subprocess.run(
            ["systemd-analyze", *mode, "verify", path], capture_output=True, text=True,
            env={**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)},
        )  # fmt: skip
        complaints = [line for line in done.stderr.splitlines() if path in line]
        new = "Unknown key( name)? 'Restart(Steps|MaxDelaySec)'"  # before systemd 254
        assert [line for line in complaints if not re.search(new, line)] == []


def test_what_the_service_writes_is_there_and_its_users(install, tmp_path, monkeypatch, capsys):
    owners = []
    monkeypatch.setattr(shutil, "chown", lambda *args: owners.append(args))
    install(SYSTEM)
    assert owners == [(Path("recordings"), os.stat(tmp_path).st_uid, os.stat(tmp_path).st_gid)]
    (tmp_path / "rigs").rmdir()
    assert main(["up", "100 % mine", "--install"]) == 2
    assert f"no folder {tmp_path}/rigs" in capsys.readouterr().err


def test_a_service_has_no_folder_for_all_of_its_runs(install, tmp_path, capsys):
    install(USER)
    assert main(["up", "100 % mine", "--install", "--out", "run"]) == 2
    assert "without --out" in capsys.readouterr().err
