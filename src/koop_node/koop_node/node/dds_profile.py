"""The profile of Fast DDS that a process gets. Pure: no ROS."""

from __future__ import annotations

import os
from importlib.resources import files
from pathlib import Path

from koop_node.process.joining import FAST_DDS

PROFILE = f"{FAST_DDS.upper()}_DEFAULT_PROFILES_FILE"  # environment variables of Fast DDS
TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"


def set_dds_profile(udp: bool = False) -> None:
    """Let Fast DDS notice a loss in 10 ms and never wait for a lost host.

    To be called before DDS starts in this process; what counts is the first call. A file of the
    user's stays. With ``udp`` what is sent to this process comes by UDP, not through shared
    memory, which under load may be lost for good; and so where the user's environment asks for it
    (``FASTDDS_BUILTIN_TRANSPORTS=UDPv4``), which rmw_fastrtps ignores in the range LOCALHOST.
    """
    udp = udp or os.environ.get(TRANSPORTS) == "UDPv4"
    folder = Path(str(files("koop_node")))
    if Path(os.environ.get(PROFILE, folder / "none")).parent == folder:  # none, or a parent's
        os.environ[PROFILE] = str(folder / f"{FAST_DDS}{'_udp' * udp}.xml")
