"""ROS domains that nobody on this machine takes part in. Pure: imports nothing of ROS."""

from __future__ import annotations

import os
import random
import socket
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from koop_core.config.parameter import ConfigError

DOMAINS = range(1, 102)  # beyond, the ports would be those that the system hands out
FIRST_PORT = 7400  # of domain 0 (DDSI-RTPS 9.6.1)
PORTS = 250  # of each domain


def current_domain() -> int:
    """Return the domain of the environment.

    Raises
    ------
    ConfigError
        If it is not a number.
    """
    text = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not text.isdecimal():
        raise ConfigError(f"ROS_DOMAIN_ID = {text!r}: must be a whole number from 0 to 101")
    return int(text)


def free_domain(candidates: Iterable[int] | None = None) -> int:
    """Return a ROS domain that nobody takes part in, so that a loop may run beside.

    Where the system does not tell who listens, it is the domain of the environment.

    Parameters
    ----------
    candidates : iterable of int, optional
        Domains in the order of preference; by default all of :data:`DOMAINS` in a random one.
    """
    order = list(candidates) if candidates is not None else random.sample(DOMAINS, len(DOMAINS))
    taken = _taken()
    if taken is None:
        return current_domain()
    return next((domain for domain in order if domain not in taken), order[0])


def is_taken(domain: int) -> bool:
    """Return whether anybody on this machine takes part in a domain; True where nothing tells."""
    taken = _taken()
    return taken is None or domain in taken


def _taken() -> set[int] | None:
    """Return the domains that somebody listens in, or None where the system does not tell.

    Any port of a domain counts: the first is not listened at where discovery keeps to this host.
    """
    try:
        table = Path("/proc/net/udp").read_text().splitlines()[1:]
    except OSError:
        return None
    ports = (int(line.split()[1].rpartition(":")[2], 16) for line in table)
    return {(port - FIRST_PORT) // PORTS for port in ports}


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
