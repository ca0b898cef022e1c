"""A free ROS domain, told from the sockets of this machine."""

import socket

from koop_node.domain import DISCOVERY_PORT, DOMAINS, free_domain


def test_a_domain_in_which_somebody_listens_is_not_free():
    taken = free_domain()
    assert taken in DOMAINS
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", DISCOVERY_PORT + 250 * taken))
        assert free_domain([taken, 0]) != taken
    assert free_domain([taken, 0]) == taken
