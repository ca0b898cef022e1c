"""A free ROS domain, told from the sockets of this machine."""

import socket
from contextlib import ExitStack

import pytest

from koop_node.process.domain import (
    DOMAINS,
    FIRST_PORT,
    PORTS,
    free_domain,
    hold_domain,
    only_observed,
)


@pytest.mark.parametrize("port", [0, 10, 13])  # for all; one participant's own
def test_a_domain_in_which_somebody_listens_is_not_free(port):
    taken = free_domain()
    assert taken in DOMAINS
    assert only_observed(taken)
    assert free_domain([taken]) == taken
    other = next(number for number in DOMAINS if number != taken and only_observed(number))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", FIRST_PORT + PORTS * taken + port))
        assert not only_observed(taken)
        assert free_domain([taken, other]) == other


def test_who_holds_a_domain_holds_it_alone():
    with ExitStack() as stack:
        held = [stack.enter_context(hold_domain()) for _ in range(30)]
        assert len(set(held)) == 30
    assert set(held) <= set(DOMAINS)


@pytest.mark.ros
@pytest.mark.parametrize("reach", ["LOCALHOST", "SUBNET"])
def test_a_participant_takes_its_domain(monkeypatch, reach):
    from koop_node.client.client import Client

    domain = free_domain()
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", reach)
    with Client("somebody", domain):
        assert not only_observed(domain)
