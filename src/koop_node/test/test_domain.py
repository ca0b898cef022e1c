"""A free ROS domain, told from the sockets of this machine."""

import socket
from contextlib import ExitStack

import pytest

from koop_core.config.parameter import ConfigError
from koop_node.process.domain import (
    DOMAINS,
    FIRST_PORT,
    PORTS,
    current_domain,
    free_domain,
    hold_domain,
    only_observed,
)


@pytest.mark.parametrize("port", [0, 10, 13])  # for all; one participant's own
def test_a_domain_in_which_somebody_listens_is_not_free(port, monkeypatch):
    taken = free_domain()
    assert taken in DOMAINS
    assert only_observed(taken)
    other = next(number for number in DOMAINS if number != taken and only_observed(number))
    monkeypatch.setattr("koop_node.process.domain.DOMAINS", [taken, other])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", FIRST_PORT + PORTS * taken + port))
        assert not only_observed(taken)
        assert free_domain() == other


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


@pytest.mark.parametrize("text", ["233", "-1", "seven"])  # 232 is the last that has ports
def test_a_domain_that_there_is_not_is_refused(text, monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    with pytest.raises(ConfigError, match=f"'{text}': must be a whole number from 0 to 232"):
        current_domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", "232")
    assert current_domain() == 232
