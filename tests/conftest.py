"""What the tests on real nodes share: a DDS domain of their own, processes that end, a probe."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from koop_node.domain import free_domain

TIMEOUT = (
    30.0  # [s] for anything to happen on a busy machine; nothing waits this long if all is well
)
_domains = itertools.count(int(os.environ.get("ROS_DOMAIN_ID", os.getpid())))


@pytest.fixture(autouse=True)
def own_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give every test a domain of its own: a killed node haunts the graph for 20 seconds.

    And one that nobody takes part in: a loop that runs beside the tests must not be disturbed.
    """
    first = next(_domains)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain((first + i) % 100 + 1 for i in range(100))))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


class Probe:
    """A node of the test, and its executor."""

    def __init__(self) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor

        self.context = rclpy.Context()
        self.context.init(args=[])
        self.node = rclpy.create_node("probe", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def spin_until(self, condition: Callable[[], Any], what: str = "") -> Any:
        """Spin until the condition is true; fail if it does not become so."""
        deadline = time.monotonic() + TIMEOUT
        while not (result := condition()):
            if time.monotonic() > deadline:
                pytest.fail(f"waited {TIMEOUT:g} s in vain for {what or condition}")
            self.executor.spin_once(timeout_sec=0.05)
        return result

    def collect(self, message_type: Any, topic: str) -> list[Any]:
        """Subscribe; what arrives is appended to the returned list."""
        messages: list[Any] = []
        self.node.create_subscription(message_type, topic, messages.append, 1000)
        return messages

    def publisher(self, message_type: Any, topic: str) -> Any:
        """Create a publisher and wait until somebody listens."""
        publisher = self.node.create_publisher(message_type, topic, 1000)
        self.spin_until(publisher.get_subscription_count, f"a subscriber on {topic}")
        return publisher

    def call(self, service_type: Any, name: str, request: Any) -> Any:
        """Call a service and return its response."""
        client = self.node.create_client(service_type, name)
        self.spin_until(client.service_is_ready, f"service {name}")
        future = client.call_async(request)
        self.spin_until(future.done, f"an answer of {name}")
        self.node.destroy_client(client)
        return future.result()

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture
def probe(own_domain: None) -> Iterator[Probe]:
    """A node of the test in the test's domain."""
    probe = Probe()
    yield probe
    probe.close()


@pytest.fixture
def start(own_domain: None, tmp_path: Path) -> Iterator[Callable[..., Any]]:
    """Start nodes by name: ``start("relay_esc", dwell=0.0)``; they are stopped after the test."""
    from koop_lab.live.loop import NodeProcess

    running = []

    def start_node(node: str, *arguments: str, **parameters: Any) -> NodeProcess:
        given = [w for name, value in parameters.items() for w in ("-p", f"{name}:={value}")]
        log = tmp_path / f"{node}-{len(running)}.log"
        process = NodeProcess(node, ["--ros-args", *given, *arguments], log)
        running.append(process)
        return process

    yield start_node
    for process in reversed(running):
        process.stop()
        assert "Traceback" not in process.log.read_text(errors="replace")
