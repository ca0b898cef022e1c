"""Each disturbance of a machine is found, with its remedy, and a machine without one has none."""

from pathlib import Path

import pytest

from koop_lab.cli.main import main
from koop_lab.commands.doctor import EXAMINATIONS, Machine

UDP = "  sl  local_address rem_address\n   0: 00000000:{port:04X} 00000000:0000 07\n"
FAULTS = [
    ("disk", {}, {"KOOP_ROOT": "/proc"}, "0.0 GiB free"),
    ("memory", {"proc/meminfo": "MemTotal: 9 kB\nMemAvailable: 1024 kB"}, {}, "0.0 GiB"),
    ("shared memory", {}, {}, "no /dev/shm: set FASTDDS"),
    ("domain", {}, {"ROS_DOMAIN_ID": "two"}, "ROS_DOMAIN_ID=two is not a number up to 232: set it"),
    ("domain", {}, {"ROS_DOMAIN_ID": "233"}, "ROS_DOMAIN_ID=233 is not a number up to 232: set it"),
    ("ports", {}, {"ROS_DOMAIN_ID": "180"}, "ROS_DOMAIN_ID=180"),
    ("ports", {"proc/net/udp": UDP.format(port=7400 + 250 * 7 + 10)}, {"ROS_DOMAIN_ID": "7"},
     "1 participant(s) in domain 7"),
    ("sessions", {"proc/sys/kernel/sched_autogroup_enabled": "1"}, {}, "from one, or sysctl"),
    ("processors", {"proc/loadavg": "400.0 1 1 1/1 1"}, {}, "load 400"),
    ("processors", {"sys/devices/system/cpu/cpu0/cpufreq/scaling_governor": "powersave"}, {},
     "cpupower"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "files", "environment", "words"), FAULTS)
def test_a_disturbance_is_found_with_its_remedy(tmp_path, name, files, environment, words):
    for path, text in files.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text)
    assert words in EXAMINATIONS[name](Machine(tmp_path, environment))


def test_what_is_well_has_no_cause(tmp_path):
    (tmp_path / "dev/shm").mkdir(parents=True)
    machine = Machine(tmp_path, {"KOOP_ROOT": str(tmp_path)})
    for name in EXAMINATIONS.keys() - {"clock", "real time"}:  # which are this machine's
        assert EXAMINATIONS[name](machine) is None, name


@pytest.mark.parametrize(("limit", "permitted"), [(0, False), (98, True), (-1, True)])
def test_a_right_without_a_limit_is_a_right(monkeypatch, limit, permitted):
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    monkeypatch.setattr("resource.getrlimit", lambda which: (limit, limit))
    machine = Machine(Path("/"), {})
    assert (EXAMINATIONS["real time"](machine) is None) is permitted


def test_an_unheard_multicast_is_found(tmp_path, monkeypatch):
    machine = Machine(tmp_path, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"})
    monkeypatch.setattr("koop_lab.commands.doctor.GROUP", "127.0.0.1")  # no group: cannot be joined
    assert "ROS_STATIC_PEERS" in EXAMINATIONS["multicast"](machine)


@pytest.mark.parametrize("domain", ["0", "two"])  # the second failed: it said nothing else
def test_each_line_says_what_was_examined(capsys, monkeypatch, domain):
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    code = main(["doctor"])
    lines = capsys.readouterr().out.splitlines()
    assert [line[6:19].strip() for line in lines] == list(EXAMINATIONS)
    if domain == "two":
        assert code == 1
        assert any(line.startswith("BAD   domain") for line in lines)
