"""ROS node of the server: topics, parameters and services of the loops in a domain."""

from __future__ import annotations

import asyncio
import os
import signal
import sys

from koop_core.errors import KoopError, one_line
from koop_node.client.client import Client
from koop_node.process.lifeline import end_with_parent
from koop_view.config import ViewConfig
from koop_view.live.source import LiveSource
from koop_view.serving import serve

NICE = 5  # the loop comes first


def run(config: ViewConfig) -> int:
    """Serve the loops of the domain until told to stop; return the exit code."""
    end_with_parent()
    os.nice(NICE)
    # its own parameters are not part of the record of a run, nor to be changed
    with Client("_koop_view", start_parameter_services=False) as client:
        try:
            source = LiveSource(client, config)
            asyncio.run(serve(source, config, source.run))
        except KoopError as error:
            print(f"error: {one_line(str(error))}", file=sys.stderr)
            return 2
        finally:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
    return 0
