"""The baseline of ``koop bench loop``: a message goes round three bare rclpy processes.

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
from rclpy.signals import SignalHandlerOptions

from koop_node.lifeline import end_with_parent

LINKS: dict[str, tuple[Any, str, Any, str]] = {
    "a": (ControlInput, "bare_theta", MeasuredState, "bare_state"),
    "b": (MeasuredState, "bare_state", Cost, "bare_cost"),
    "c": (Cost, "bare_cost", ControlInput, "bare_theta"),
}


def main(role: str, steps: int = 0) -> None:
    """Run one process of the chain; ``a`` starts it, counts and prints the rate [1/s]."""
    stop: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, frame: stop.append(number))
    end_with_parent()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node(f"bare_{role}")
    in_type, in_topic, out_type, out_topic = LINKS[role]
    publisher = node.create_publisher(out_type, out_topic, 100)
    answer = out_type()
    if role == "a":
        answer.x = [1.0, 2.0]

    def on_message(message: Any) -> None:
        if role == "a":
            answer.step = message.step + 1
            if answer.step >= steps:
                stop.append(0)
                return
        else:
            answer.header = message.header
            answer.step = message.step
        publisher.publish(answer)

    node.create_subscription(in_type, in_topic, on_message, 100)
    executor: Any = EventsExecutor()
    executor.add_node(node)
    while publisher.get_subscription_count() < 1 or node.count_publishers(in_topic) < 1:
        executor.spin_once(timeout_sec=0.05)
    started = time.perf_counter()
    while not stop:
        if role == "a" and answer.step == 0:  # until the first message has made it round
            publisher.publish(answer)
            started = time.perf_counter()
        executor.spin_once(timeout_sec=0.2)
    if role == "a" and answer.step >= steps:  # else it was told to stop
        print((steps - 1) / (time.perf_counter() - started))


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
