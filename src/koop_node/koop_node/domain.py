"""ROS domains that nobody on this machine takes part in. Pure: imports nothing of ROS."""

from __future__ import annotations

import os
import random
import socket
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

DOMAINS = range(1, 102)  # beyond, the ports would be those that the system hands out
DISCOVERY_PORT = 7400  # of domain 0; 250 ports a domain (DDSI-RTPS 9.6.1)


def free_domain(candidates: Iterable[int] | None = None) -> int:
    """Return a ROS domain that nobody takes part in, so that a loop may run beside.

    Who takes part listens at the domain's discovery port; where the system does not tell who
    listens, it is the domain of the environment.

    Parameters
    ----------
    candidates : iterable of int, optional
        Domains in the order of preference; by default all of :data:`DOMAINS` in a random one.
    """
    order = list(candidates) if candidates is not None else random.sample(DOMAINS, len(DOMAINS))
    try:
        table = Path("/proc/net/udp").read_text().splitlines()[1:]
    except OSError:
        return int(os.environ.get("ROS_DOMAIN_ID", 0))
    ports = {int(line.split()[1].rpartition(":")[2], 16) for line in table}
    free = (domain for domain in order if DISCOVERY_PORT + 250 * domain not in ports)
    return next(free, order[0])


@contextmanager
def hold_domain() -> Iterator[int]:
    """Hold a ROS domain that nobody takes part in, for tests that run in several processes.

    A bound port tells the others that the domain is taken, before a node takes part in it.
    """
    while True:
        domain = free_domain()
        with socket.socket() as taken:
            try:
                taken.bind(("127.0.0.1", DISCOVERY_PORT + 250 * domain))  # of TCP; DDS has UDP's
            except OSError:
                continue
            yield domain
            return
