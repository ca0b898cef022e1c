"""A second host on one machine: namespaces with a network and shared memory of their own.

Each host has a virtual cable to a switch, which is a namespace too; pulled out there, both hosts
see what they would see of a real one: no carrier. Nothing has a name outside: the kernel drops the
namespaces, and the devices in them, with the last process inside, however it ended. Shared memory
must be separate too: DDS uses it where it can, and cutting the link would not stop it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

from koop_bringup.live.process import TiedProcess
from koop_core.errors import KoopError, LiveError
from koop_node.process.lifeline import OWN_GROUP

HOSTS = {"koop0": "198.18.0.1/30", "koop1": "198.18.0.2/30"}  # kept free for tests (RFC 2544)
HERE, THERE = HOSTS
TOOLS = {
    "ip": "iproute2",
    **dict.fromkeys(("mount", "nsenter", "unshare"), "util-linux"),
}
OWN = ("unshare", "--net", "--mount", "sh", "-ec")
SETUP = 'mount -t tmpfs tmpfs /dev/shm; ip link set lo up; exec "$@"'
SWITCH = "ip link add switch type bridge mcast_snooping 0; ip link set switch up"
TRIAL = f"ip link add {HERE} type veth peer name {THERE}; {SWITCH}"


class HostsError(KoopError):
    """A second host cannot be made here; the message says why."""


def entrance() -> list[str]:
    """Return the command prefix that gives a command a host of its own.

    Namespaces alone where that is permitted, to root; else a user namespace around them, in which
    a user may do so.

    Raises HostsError if a tool is missing or the system refuses.
    """
    for tool, package in TOOLS.items():
        if shutil.which(tool) is None:
            raise HostsError(f"two hosts on one machine need '{tool}' ({package})")
    said = ""
    for user in ((), ("--user", "--map-root-user")):
        words = [OWN[0], *user, *OWN[1:], SETUP, "sh"]
        # in the trial, too, the second host is made inside the first
        trial = subprocess.run(
            [*words, *OWN, f"{TRIAL}; {SETUP}", "sh", "true"], capture_output=True, text=True
        )
        if trial.returncode == 0:
            return words
        said = (trial.stderr.strip().splitlines() or [f"exit code {trial.returncode}"])[-1]
    raise HostsError(f"two hosts on one machine need network namespaces: {said}")


def call_isolated(command: list[str]) -> int:
    """Run a command on a host of its own; return its exit code.

    Raises HostsError if no such host can be made here.
    """
    environment = {
        name: value for name, value in os.environ.items() if name != "ROS_LOCALHOST_ONLY"
    }
    # a rig's own default is the loopback; an empty text is Cyclone DDS's, all of the network
    environment |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "CYCLONEDDS_URI": ""}
    # Ctrl-C reaches it once, from here
    process = TiedProcess([*entrance(), *command], environment, **OWN_GROUP)
    try:
        return process.wait()
    except BaseException:
        process.terminate()
        process.wait()
        raise


@contextmanager
def namespace() -> Iterator[tuple[int, list[str]]]:
    """Make a network and shared memory that no other process shares.

    Yields
    ------
    pid : int
        A process in it.
    words : list of str
        Command prefix that runs a command there.
    """
    # 'cat' holds it while nothing else runs there, and ends when this process does
    keeper = subprocess.Popen(
        [*OWN, SETUP, "sh", "sh", "-c", "echo ready; exec cat"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,
    )
    try:
        assert keeper.stdout is not None
        if not keeper.stdout.readline():
            raise LiveError("no further network namespace can be made")
        enter = ["nsenter", f"--target={keeper.pid}", "--net", "--mount"]
        yield keeper.pid, [*enter, "env", f"--chdir={os.getcwd()}"]
    finally:
        keeper.kill()
        keeper.communicate()


class OtherHost(NamedTuple):
    """The host at the other end of the link: command prefixes of it, and of the switch between."""

    words: list[str]
    switch: list[str]

    def link(self, up: bool) -> None:
        """Put both cables into the switch, or pull them out."""
        for device in HOSTS:
            _run(self.switch, f"ip link set {device} {'up' if up else 'down'}")


@contextmanager
def other_host() -> Iterator[OtherHost]:
    """Make another host that is linked to this one; to be used inside the :func:`entrance`.

    Raises LiveError if the system refuses.
    """
    with namespace() as (pid, switch), namespace() as (_, host):
        _run(switch, SWITCH)
        for words, (device, address) in zip(([], host), HOSTS.items(), strict=True):
            cable = f"ip link add {device} type veth peer name {device} netns {pid}"
            _run(words, f"{cable}; ip address add {address} dev {device}; ip link set {device} up")
            _run(switch, f"ip link set {device} master switch up")
        yield OtherHost(host, switch)


def _run(words: list[str], script: str) -> None:
    done = subprocess.run([*words, "sh", "-ec", script], capture_output=True, text=True)
    if done.returncode != 0:
        raise LiveError(f"'{script}' failed: {done.stderr.strip()}")
