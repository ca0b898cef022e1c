"""By what way a node is sent to: a mailbox in shared memory, or UDP where the user asks for it."""

import os
import re
from pathlib import Path

import pytest
from lifecycle_msgs.srv import GetState

from koop_node.node.dds_profile import TRANSPORTS
from koop_node.process.joining import FAST_DDS


def mailboxes(process):
    """Return the files in shared memory by which a process hears."""
    links = [os.readlink(item) for item in Path(f"/proc/{process.process.pid}/fd").iterdir()]
    return [link for link in links if re.fullmatch(rf"/dev/shm/{FAST_DDS}_port\d+_el", link)]


@pytest.mark.parametrize(("transports", "wanted"), [(None, True), ("UDPv4", False)])
def test_a_node_has_no_mailbox_in_shared_memory_where_the_user_asks_for_udp(
    start, probe, monkeypatch, transports, wanted
):
    monkeypatch.delenv(TRANSPORTS, raising=False)
    if transports is not None:
        monkeypatch.setenv(TRANSPORTS, transports)
    process = start("relay_esc")
    assert probe.call(GetState, "/relay_esc/get_state", GetState.Request()).current_state.label
    assert bool(mailboxes(process)) == wanted
