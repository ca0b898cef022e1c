"""ROS node of the server: topics, parameters and services of the loops in a domain."""

from __future__ import annotations

import asyncio
import os
import signal
import sys

import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.signals import SignalHandlerOptions

from koop_core.errors import KoopError, one_line
from koop_node.node.dds_profile import set_dds_profile
from koop_node.node.rclpy_internals import WithoutEvents
from koop_node.process.lifeline import end_with_parent
from koop_view.config import ViewConfig
from koop_view.live.source import LiveSource
from koop_view.serving import serve

NICE = 5  # the loop comes first


def run(config: ViewConfig) -> int:
    """Serve the loops of the domain until told to stop; return the exit code."""
    end_with_parent()
    set_dds_profile(udp=True)
    os.nice(NICE)
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    # its own parameters are not part of the record of a run, nor to be changed
    node, executor = WithoutEvents("_koop_view", start_parameter_services=False), EventsExecutor()
    executor.add_node(node)
    try:
        source = LiveSource(node, executor, config)
        asyncio.run(serve(source, config, source.run))
    except KoopError as error:
        print(f"error: {one_line(str(error))}", file=sys.stderr)
        return 2
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        executor.remove_node(node)
        node.destroy_node()
        executor.shutdown()
        rclpy.try_shutdown()
    return 0
