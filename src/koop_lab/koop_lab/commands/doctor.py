"""``koop doctor``: what of this machine will disturb a loop, and the remedy in a line each."""

from __future__ import annotations

import argparse
import ctypes
import os
import resource
import shutil
import socket
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from koop_node.process.domain import LAST

PORTS = 7400, 250  # of DDS: the first, and how many a domain has (RTPS 2.5, section 9.6.1.1)
DOMAINS = 102  # whose ports end below Linux's range of ephemeral ports
GROUP = "239.255.0.1"  # by which DDS participants discover each other
UNSYNCHRONISED = 5  # TIME_ERROR of adjtimex(2)
GIB = 1 << 30


class Machine(NamedTuple):
    """What is examined: the root of its files, and the environment."""

    root: Path
    environment: Mapping[str, str]

    def read(self, path: str) -> str:
        """Return a small file's text; empty where there is none."""
        try:
            return (self.root / path).read_text().strip()
        except OSError:
            return ""

    @property
    def domain(self) -> int | None:
        """ROS_DOMAIN_ID, which DDS's ports follow from; None where it has none."""
        text = self.environment.get("ROS_DOMAIN_ID") or "0"
        return int(text) if text.isdecimal() and int(text) <= LAST else None


Cause = str | None  # of a disturbance, with the remedy; None: all is well


def judge_python(machine: Machine) -> Cause:
    """Find a Python that has no wheels: they are made for some versions."""
    if (3, 10) <= sys.version_info[:2] <= (3, 13):
        return None
    return f"{sys.version.split()[0]}: the ROS 2 wheels are for 3.10 to 3.13; set KOOP_PYTHON"


def judge_disk(machine: Machine) -> Cause:
    """Find a full disk: a recording of a loop at 200 Hz takes 2 GB a day."""
    free = shutil.disk_usage(machine.environment.get("KOOP_ROOT", ".")).free
    if free > 2 * GIB:
        return None
    return f"{free / GIB:.1f} GiB free: free some, record elsewhere (--out), or set keep_size"


def judge_memory(machine: Machine) -> Cause:
    """Six processes of a loop take 0.6 GB, a tuning 1 GB."""
    lines = (line.split() for line in machine.read("proc/meminfo").splitlines())
    free = next((int(words[1]) << 10 for words in lines if words[0] == "MemAvailable:"), GIB)
    if free >= GIB:
        return None
    return f"{free / GIB:.1f} GiB of memory available: end what is not needed"


def judge_shared_memory(machine: Machine) -> Cause:
    """Fast DDS sends within a machine by segments in /dev/shm."""
    remedy = "set FASTDDS_BUILTIN_TRANSPORTS=UDPv4 for all nodes"
    try:
        free = shutil.disk_usage(machine.root / "dev/shm").free
    except OSError:
        return f"there is no /dev/shm: {remedy}"
    if free > GIB // 16:
        return None
    return f"{free >> 20} MiB free in /dev/shm: enlarge it (docker run --shm-size=1g), or {remedy}"


def judge_multicast(machine: Machine) -> Cause:
    """Nodes of several hosts discover each other by multicast."""
    if machine.environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST") != "SUBNET":
        return None
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.settimeout(1.0)
        receiver.bind(("", 0))
        try:
            join = socket.inet_aton(GROUP) + socket.inet_aton("0.0.0.0")
            receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, join)
            receiver.sendto(b"koop", (GROUP, receiver.getsockname()[1]))
            receiver.recv(4)
        except OSError as error:
            return f"not heard ({error}): allow it, or name the hosts in ROS_STATIC_PEERS"
    return None


def judge_domain(machine: Machine) -> Cause:
    """Find a domain that DDS has no ports for: no node starts."""
    if machine.domain is not None:
        return None
    text = machine.environment["ROS_DOMAIN_ID"]
    return f"ROS_DOMAIN_ID={text} is not a number up to {LAST}: set it to 0 to {DOMAINS - 1}"


def judge_ports(machine: Machine) -> Cause:
    """Another loop of the same domain and namespace is one publisher too many."""
    domain = machine.domain
    if domain is None:
        return None
    if domain >= DOMAINS:
        return f"ROS_DOMAIN_ID={domain}: its ports may be taken by others; use 0 to {DOMAINS - 1}"
    lines = machine.read("proc/net/udp").splitlines()[1:]
    ports = {int(line.split()[1].split(":")[1], 16) for line in lines}
    first = PORTS[0] + PORTS[1] * domain
    others = len([port for port in ports if first + 10 <= port < first + PORTS[1] and not port % 2])
    if not others:
        return None
    return f"{others} participant(s) in domain {domain}: mind their topics, or set ROS_DOMAIN_ID"


def judge_clock(machine: Machine) -> Cause:
    """Delays between hosts are differences of two clocks."""
    if ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(512)) != UNSYNCHRONISED:
        return None
    return "not synchronised: with two hosts run chrony or ntpd on both; one host needs nothing"


def judge_priority(machine: Machine) -> Cause:
    """Find a missing right: the parameter ``priority`` needs it."""
    if os.geteuid() == 0 or resource.getrlimit(resource.RLIMIT_RTPRIO)[0] != 0:  # -1: unlimited
        return None
    return "not permitted: add '@realtime - rtprio 98' to /etc/security/limits.d and log in again"


def judge_sessions(machine: Machine) -> Cause:
    """Processors are divided between sessions first."""
    if machine.read("proc/sys/kernel/sched_autogroup_enabled") != "1":
        return None
    return (
        "nodes of several terminals may wait seconds for a processor: start them from one, or "
        "sysctl kernel.sched_autogroup_enabled=0"
    )


def judge_processors(machine: Machine) -> Cause:
    """Find a processor that sleeps deeply, and answers late."""
    governor = machine.read("sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")
    load = float((machine.read("proc/loadavg") or "0").split()[0])
    if governor == "powersave":
        return "governor powersave: cpupower frequency-set -g performance"
    if load <= (os.cpu_count() or 1):
        return None
    return f"load {load:g} on {os.cpu_count()}: a loop in real time will be late; end what is busy"


EXAMINATIONS: dict[str, Callable[[Machine], Cause]] = {
    "Python": judge_python,
    "disk": judge_disk,
    "memory": judge_memory,
    "shared memory": judge_shared_memory,
    "multicast": judge_multicast,
    "domain": judge_domain,
    "ports": judge_ports,
    "clock": judge_clock,
    "real time": judge_priority,
    "sessions": judge_sessions,
    "processors": judge_processors,
}
PREVENTING = ("Python", "disk", "memory", "shared memory", "multicast", "domain")  # others disturb


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    commands.add_parser("doctor").set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code."""
    machine = Machine(Path("/"), os.environ)
    causes = {name: judge(machine) for name, judge in EXAMINATIONS.items()}
    for name, cause in causes.items():
        level = "ok" if cause is None else "BAD" if name in PREVENTING else "note"
        print(f"{level:<4}  {name:<13}  {cause or ''}".rstrip())
    return 1 if any(causes[name] for name in PREVENTING) else 0
