"""A free ROS domain, told from the sockets of this machine."""

import socket
from contextlib import ExitStack

from koop_node.domain import DISCOVERY_PORT, DOMAINS, free_domain, hold_domain


def test_a_domain_in_which_somebody_listens_is_not_free():
    taken = free_domain()
    assert taken in DOMAINS
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", DISCOVERY_PORT + 250 * taken))
        assert free_domain([taken, 0]) != taken
    assert free_domain([taken, 0]) == taken


def test_who_holds_a_domain_holds_it_alone():
    with ExitStack() as stack:
        held = [stack.enter_context(hold_domain()) for _ in range(30)]
        assert len(set(held)) == 30
    assert set(held) <= set(DOMAINS)
