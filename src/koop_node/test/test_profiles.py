"""The profiles of Fast DDS, and which of them a process gets."""

import os
import time
import xml.etree.ElementTree as ET
from importlib.resources import files
from pathlib import Path

import pytest
from std_msgs.msg import Empty

from koop_node.client.client import Client
from koop_node.node.dds_profile import PROFILE, TRANSPORTS, set_dds_profile
from koop_node.node.qos import RELIABLE
from koop_node.process.joining import FAST_DDS

OWN = Path(str(files("koop_node")))
NODES, BY_UDP = OWN / f"{FAST_DDS}.xml", OWN / f"{FAST_DDS}_udp.xml"


@pytest.mark.parametrize("name", ["fastrtps", "fastdds"])
def test_the_profile_by_udp_differs_from_the_nodes_in_how_it_is_sent_to_only(name):
    nodes, by_udp = (ET.parse(OWN / f"{name}{udp}.xml") for udp in ("", "_udp"))
    participant = next(item for item in by_udp.iter() if item.tag.endswith("}rtps"))
    (address,) = [item for item in participant if item.tag.endswith("}defaultUnicastLocatorList")]
    assert [item.tag.rpartition("}")[2] for item in address.iter()][1:] == ["locator", "udpv4"]
    participant.remove(address)
    texts = [ET.tostring(item.getroot(), encoding="unicode") for item in (nodes, by_udp)]
    plain = [ET.canonicalize(text, strip_text=True) for text in texts]
    assert plain[0] == plain[1]


@pytest.mark.parametrize(
    ("options", "udp", "expected"),
    [
        (None, False, NODES),
        (None, True, BY_UDP),
        (NODES, True, BY_UDP),  # of the command that started it
        (BY_UDP, False, NODES),
        ("/etc/rig/dds.xml", True, "/etc/rig/dds.xml"),
        ("", False, ""),
    ],
)
def test_a_profile_of_the_users_stays_and_one_of_a_parent_does_not(
    monkeypatch, options, udp, expected
):
    monkeypatch.delenv(PROFILE, raising=False)
    monkeypatch.delenv(TRANSPORTS, raising=False)
    if options is not None:
        monkeypatch.setenv(PROFILE, str(options))
    set_dds_profile(udp)
    assert os.environ[PROFILE] == str(expected)
    monkeypatch.setenv(PROFILE, os.environ[PROFILE])  # to be undone


@pytest.mark.parametrize(
    ("transports", "expected"),
    [("UDPv4", BY_UDP), ("SHM", NODES), ("", NODES)],
)
def test_who_asks_fast_dds_for_udp_is_sent_to_by_udp(monkeypatch, transports, expected):
    monkeypatch.setenv(PROFILE, str(NODES))
    monkeypatch.setenv(TRANSPORTS, transports)
    set_dds_profile()
    assert os.environ[PROFILE] == str(expected)


@pytest.mark.ros
def test_who_listens_late_in_the_process_of_a_writer_hears_its_next_message():
    """As a node of a container that is activated when the loop has run for a while."""
    with Client("nodes") as client:
        publisher = client.node.create_publisher(Empty, "beat", RELIABLE)
        for _ in range(5100):  # more than a reader of Fast DDS's default could wait for
            publisher.publish(Empty())
        heard = []
        client.node.create_subscription(Empty, "beat", heard.append, RELIABLE)
        client.wait_for(publisher.get_subscription_count, 60.0, "a subscriber")
        begin = time.monotonic()
        client.wait_for(lambda: time.monotonic() > begin + 1.0, 60.0, "the end of what they settle")
        publisher.publish(Empty())
        client.wait_for(lambda: heard, 10.0, "the message")
