"""One loop in a namespace of a ROS domain."""

import os
import subprocess
import sys

import pytest

from koop_core.errors import LiveError
from koop_node.client.alone import alone, is_empty
from koop_node.client.client import Client
from koop_node.process import domain as domains
from koop_node.process.domain import current_domain

WORKER = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
OWN, OTHER = 215 + WORKER % 8, 224 + WORKER % 8
"""Beyond the domains that tests hold and commands propose, so that nobody is there."""


@pytest.fixture(autouse=True)
def domain(monkeypatch):
    """A domain in which nobody is, so that nobody has to be looked for."""
    domain = OWN
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return domain


def test_who_comes_second_is_refused_until_the_first_has_gone(domain):
    with (
        alone(),
        pytest.raises(LiveError, match=f"on ROS domain {domain}: it goes on") as caught,
        alone(),
    ):
        pytest.fail("there is a loop already")
    proposed = int(str(caught.value).rsplit(" ", 1)[1])
    assert proposed != domain
    with alone():
        pass


def test_loops_of_other_namespaces_and_domains_do_not_meet(monkeypatch):
    with alone(), alone("/rig1"), alone("/rig2"):
        with pytest.raises(LiveError, match="in the namespace /rig1"), alone("/rig1"):
            pytest.fail("there is a loop already")
        monkeypatch.setenv("ROS_DOMAIN_ID", str(OTHER))
        with alone():
            pass


DAEMON = """
import rclpy
rclpy.init()
node = rclpy.create_node("_ros2cli_daemon")
print("there", flush=True)
rclpy.spin(node)
"""


@pytest.mark.ros
def test_a_daemon_of_ros2cli_is_not_waited_for():
    """What it takes part in would else be looked at for 4 s, before every start."""
    words = [sys.executable, "-c", DAEMON, "from ros2cli.daemon.daemonize import main; main()"]
    with subprocess.Popen(words, stdout=subprocess.PIPE) as daemon:
        try:
            assert daemon.stdout.readline() == b"there\n"
            domain = current_domain()
            assert domain in domains._sockets().values()
            assert is_empty(domain)
            with Client("by_hand"):
                assert not is_empty(domain)
        finally:
            daemon.kill()


@pytest.mark.ros
@pytest.mark.parametrize("topic", ["theta", "koop_guard/state"])
def test_nodes_that_end_are_waited_for(monkeypatch, topic):
    """The command that started them was killed, and is given again at once."""
    from std_msgs.msg import Float64

    with Client("killed") as client:
        publisher = client.node.create_publisher(Float64, topic, 1)
        spin = Client.spin

        def end_and_spin(other, seconds):
            if other.node.count_publishers(f"/{topic}"):
                client.node.destroy_publisher(publisher)
            spin(other, seconds)

        monkeypatch.setattr(Client, "spin", end_and_spin)
        with alone():
            assert client.node.count_publishers(f"/{topic}") == 0


@pytest.mark.ros
@pytest.mark.parametrize("topic", ["state", "theta"])
def test_nodes_that_were_started_by_hand_are_seen(topic):
    from diagnostic_msgs.msg import DiagnosticArray

    with Client("by_hand") as client:
        client.node.create_publisher(DiagnosticArray, topic, 1)
        with pytest.raises(LiveError, match="another loop runs"), alone():
            pytest.fail("there is a loop already")
