"""The baselines of ``koop bench loop``: a message goes round three bare rclpy nodes.

Run as ``python -m koop_bench.bare_chain LINKS STEPS [raw]``, with LINKS a, b, c or abc.

No mathematics, no checks, no lifecycle: what the middleware alone costs for these messages.
"""

from __future__ import annotations

import signal
import sys
import time
from typing import Any

import rclpy
from koop_msgs.msg import ControlInput, Cost, MeasuredState
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions

from koop_node.process.lifeline import end_with_parent

LINKS: dict[str, tuple[Any, str, Any, str]] = {
    "a": (ControlInput, "bare_theta", MeasuredState, "bare_state"),
    "b": (MeasuredState, "bare_state", Cost, "bare_cost"),
    "c": (Cost, "bare_cost", ControlInput, "bare_theta"),
}


def main(roles: str, steps: int, raw: bool) -> None:
    """Run links of the chain in this process; ``a`` starts it, counts and prints the rate [1/s].

    Raw links take bytes and publish bytes that were made in advance.
    """
    stop: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, frame: stop.append(number))
    end_with_parent()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    executor: Any = EventsExecutor()
    links = [BareLink(role, raw, steps, stop) for role in roles]
    for link in links:
        executor.add_node(link.node)
    while not all(link.connected() for link in links):
        executor.spin_once(timeout_sec=0.05)
    first = links[0]
    started = time.perf_counter()
    while not stop:
        if first.role == "a" and first.step == 0:  # until the first message has made it round
            first.publisher.publish(first.answer)
            started = time.perf_counter()
        executor.spin_once(timeout_sec=0.2)
    if first.step >= steps:  # else it was told to stop
        print((steps - 1) / (time.perf_counter() - started))


class BareLink:
    """A node that answers a message with another one; ``a`` fills ``stop`` after so many steps."""

    def __init__(self, role: str, raw: bool, steps: int, stop: list[int]) -> None:
        self.role, self.step = role, 0
        self.node = Node(f"bare_{role}")
        in_type, self._from, out_type, out_topic = LINKS[role]
        self.publisher = self.node.create_publisher(out_type, out_topic, 100)
        message = out_type()
        if role == "a":
            message.x = [1.0, 2.0]
        self.answer = serialize_message(message) if raw else message

        def on_message(received: Any) -> None:
            if role == "a":
                self.step += 1
                if self.step >= steps:
                    stop.append(0)
                    return
                if not raw:
                    message.step = received.step + 1
            elif not raw:
                message.header = received.header
                message.step = received.step
            self.publisher.publish(self.answer)

        self.node.create_subscription(in_type, self._from, on_message, 100, raw=raw)

    def connected(self) -> bool:
        """Return whether it hears the link before it and the one after hears it."""
        heard = self.publisher.get_subscription_count() >= 1
        return heard and bool(self.node.count_publishers(self._from))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3:] == ["raw"])
