"""What the tests share: processes that end, a probe; their helpers can be imported."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # for browser.py and waiting.py

from waiting import TIMEOUT

from koop_bringup.live.process import NodeProcess
from koop_node.client.question import Question


class Probe:
    """A node of the test, and its executor."""

    def __init__(self) -> None:
        import rclpy
        from rclpy.experimental.events_executor import EventsExecutor

        from koop_node.node.dds_profile import set_dds_profile
        from koop_node.node.rclpy_internals import WithoutEvents

        set_dds_profile(udp=True)  # else what is lost on the way is sent again seconds later
        self.context = rclpy.Context()
        self.context.init(args=[])
        self.node = WithoutEvents("probe", context=self.context)
        self.executor: Any = EventsExecutor(context=self.context)
        self.executor.add_node(self.node)

    def spin_until(
        self, condition: Callable[[], Any], what: str = "", seconds: float = TIMEOUT
    ) -> Any:
        """Spin until the condition is true; fail if it does not become so."""
        deadline = time.monotonic() + seconds
        while not (result := condition()):
            if time.monotonic() > deadline:
                pytest.fail(f"timed out after {seconds:g} s: {what or condition}")
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
        answer = self.spin_until(Question(client, request).answer, f"an answer of {name}")
        self.node.destroy_client(client)
        return answer

    def state_of(self, node: str) -> str:
        """Return the state of a managed node."""
        from lifecycle_msgs.srv import GetState

        answer = self.call(GetState, f"{node}/get_state", GetState.Request())
        return str(answer.current_state.label)

    def change_state(self, node: str, transition: str) -> bool:
        """Make a node ``configure``, ``activate``, ``deactivate`` or ``cleanup``, if it will.

        What is asked again, for its answer got lost, is refused where it was done.
        """
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        number = getattr(Transition, f"TRANSITION_{transition.upper()}")
        request = ChangeState.Request(transition=Transition(id=number))
        done = self.call(ChangeState, f"{node}/change_state", request).success
        aims = {"activate": "active", "cleanup": "unconfigured"}
        return done or self.state_of(node) == aims.get(transition, "inactive")

    def __enter__(self) -> Probe:
        return self

    def __exit__(self, *error: object) -> None:
        self.executor.remove_node(self.node)
        self.node.destroy_node()
        self.executor.shutdown()
        self.context.try_shutdown()


@pytest.fixture
def probe(own_domain: None) -> Iterator[Probe]:
    """A node of the test in the test's domain."""
    with Probe() as probe:
        yield probe


@pytest.fixture(scope="module")
def module_probe(module_domain: str) -> Iterator[Probe]:
    """A node of the test in the module's domain."""
    with Probe() as probe:
        yield probe


class Nodes:
    """Starts nodes by name, as in ``nodes("relay_esc", dwell=0.0)``, and stops them at its end."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.running: list[NodeProcess] = []

    def __call__(self, node: str, *arguments: str, **parameters: Any) -> NodeProcess:
        options = [w for name, value in parameters.items() for w in ("-p", f"{name}:={value}")]
        log = self.folder / f"{node}-{len(self.running)}.log"
        process = NodeProcess(node, ["--ros-args", *options, *arguments], log)
        self.running.append(process)
        return process

    def __enter__(self) -> Nodes:
        return self

    def __exit__(self, *error: object) -> None:
        for process in reversed(self.running):
            process.stop()
        for process in self.running:
            assert "Traceback" not in process.log.read_text(errors="replace")


@pytest.fixture
def start(own_domain: None, tmp_path: Path) -> Iterator[Nodes]:
    """Start nodes in the test's domain; they are stopped after the test."""
    with Nodes(tmp_path) as nodes:
        yield nodes


@pytest.fixture(scope="module")
def module_start(module_domain: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nodes]:
    """Start nodes in the module's domain; they are stopped after its last test."""
    with Nodes(tmp_path_factory.mktemp("nodes")) as nodes:
        yield nodes


def nodes_of(process: Any) -> dict[str, int]:
    """Return the processes that a command has started, by the names of their executables."""
    actual = {}
    for pid in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{pid}/stat") as file:
                parent = int(file.read().rpartition(")")[2].split()[1])
            with open(f"/proc/{pid}/cmdline", "rb") as file:
                words = file.read().decode().split("\0")
        except OSError:
            continue
        names = [word.rsplit("/", 1)[-1] for word in words if "/lib/" in word]
        if parent == process.pid and "koop_node.process.companion" in words:
            actual["rig"] = int(pid)
        elif parent == process.pid and names:
            actual[names[0]] = int(pid)
    return actual


@pytest.fixture(name="nodes_of")
def nodes_of_fixture() -> Callable[[Any], dict[str, int]]:
    """Return :func:`nodes_of`."""
    return nodes_of
