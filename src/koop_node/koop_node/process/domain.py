"""ROS domains that nobody on this machine takes part in. Pure: imports nothing of ROS."""

from __future__ import annotations

import os
import random
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from koop_core.config.parameter import ConfigError

DOMAINS = range(1, 102)  # beyond, the ports would be those that the system hands out
LAST = 232  # that has ports
FIRST_PORT = 7400  # of domain 0 (DDSI-RTPS 9.6.1)
PORTS = 250  # of each domain
DAEMON = b"ros2cli.daemon"  # in the command line of ros2cli's daemon


def current_domain() -> int:
    """Return the domain of the environment; raise ConfigError if it is not a number."""
    text = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not text.isdecimal() or int(text) > LAST:
        raise ConfigError(f"ROS_DOMAIN_ID = {text!r}: must be a whole number from 0 to {LAST}")
    return int(text)


def free_domain() -> int:
    """Return a ROS domain that nobody takes part in, so that a loop may run beside."""
    taken = set(_sockets().values())
    free = [domain for domain in DOMAINS if domain not in taken]
    return random.choice(free or DOMAINS)


def only_observed(domain: int) -> bool:
    """Return whether it is certain that nobody takes part in a domain here, or only observers.

    That is the daemon that ``ros2 topic list`` and its like leave behind: it publishes nothing.
    """
    sockets = {f"socket:[{inode}]" for inode, number in _sockets().items() if number == domain}
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended, or is another user's
            if DAEMON in (process / "cmdline").read_bytes():
                sockets -= {os.readlink(file) for file in (process / "fd").iterdir()}
    return not sockets


def _sockets() -> dict[int, int]:
    """Return the domain of every socket by its inode.

    Any port of a domain counts: the first is not listened at where discovery keeps to this host.
    """
    table = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
    return {
        int(words[9]): (int(words[1].rpartition(":")[2], 16) - FIRST_PORT) // PORTS
        for words in table
    }


@contextmanager
def hold_domain() -> Iterator[int]:
    """Hold a ROS domain that nobody takes part in, for tests that run in several processes.

    A bound port tells the others that the domain is taken, before a node takes part in it.
    """
    while True:
        domain = free_domain()
        with socket.socket() as taken:
            try:
                taken.bind(("127.0.0.1", FIRST_PORT + PORTS * domain))  # of TCP; DDS has UDP's
            except OSError:
                continue
            yield domain
            return
