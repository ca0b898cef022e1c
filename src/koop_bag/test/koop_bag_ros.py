"""A recorder or player in a process of its own and nodes that talk to it."""

from __future__ import annotations

import resource
import signal
import subprocess
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

import rclpy
from ament_index_python.packages import get_package_prefix
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message

from koop_bag.bag.reader import BagReader
from koop_bag.errors import BagError
from koop_node.client.question import Question
from koop_node.node.managed import message_type

Self = TypeVar("Self", bound="Program")
PATIENCE = 60.0  # [s] for what should take far less


def wait_until(condition: Callable[[], Any], what: str) -> Any:
    """Return the first true value of a condition."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        if value := condition():
            return value
        time.sleep(0.01)
    raise AssertionError(f"waited {PATIENCE} s for {what}")


class Program:
    """`ros2 run koop_bag NAME`; a context manager that leaves no process behind."""

    def __init__(self, name: str, log: Path, options: list[str], file_limit: int = 0) -> None:
        self.log = log
        program = Path(get_package_prefix("koop_bag")) / "lib" / "koop_bag" / name

        def limit() -> None:
            if file_limit:
                resource.setrlimit(resource.RLIMIT_FSIZE, (file_limit, file_limit))

        with open(self.log, "wb") as output:
            self.process = subprocess.Popen(
                [str(program), "--ros-args", *options],
                stdout=subprocess.PIPE if file_limit else output,
                stderr=subprocess.STDOUT,
                preexec_fn=limit,
            )

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()

    def output(self) -> str:
        """Return what it said."""
        return self.log.read_text()

    def stop(self, number: int = signal.SIGINT) -> float:
        """Send a signal, wait for the end, return how long it took [s]."""
        begin = time.monotonic()
        self.process.send_signal(number)
        self.process.wait(PATIENCE)
        return time.monotonic() - begin

    def end(self) -> int:
        """Wait until it ends by itself; return the exit code."""
        self.process.wait(PATIENCE)
        return self.process.returncode


class Recorder(Program):
    """`ros2 run koop_bag recorder`."""

    def __init__(self, folder: Path, *arguments: str, file_limit: int = 0) -> None:
        self.folder = folder
        options = ["-p", f"output:={folder}", *arguments]
        super().__init__("recorder", folder.parent / f"{folder.name}.log", options, file_limit)

    def wait_for(self, topic: str, count: int) -> None:
        """Wait until so many messages of a topic are on the disk.

        A publisher may be matched a moment before the recorder knows of it; what it sends
        meanwhile comes later.
        """

        def recorded() -> bool:
            try:
                with BagReader(self.folder) as reader:
                    return reader.topic(topic).count >= count
            except BagError:
                return False

        wait_until(recorded, f"{count} messages on {topic}")


class Player(Program):
    """`ros2 run koop_bag player`; keyword arguments are its parameters."""

    def __init__(self, path: Path, *arguments: str, **parameters: Any) -> None:
        options = {"bag": path, **parameters}
        words = [word for name, value in options.items() for word in ("-p", f"{name}:={value}")]
        log = path.parent / f"{path.name}-player.log"
        super().__init__("player", log, [*words, *arguments])


class Talker:
    """A node with publishers, in this process."""

    def __init__(
        self,
        name: str = "talker",
        namespace: str = "",
        node_class: Callable[..., Any] = Node,
        **parameters: Any,
    ) -> None:
        self.context = rclpy.Context()
        self.context.init(args=[])
        self.node = node_class(
            name,
            namespace=namespace,
            context=self.context,
            parameter_overrides=[Parameter(key, value=v) for key, v in parameters.items()],
            automatically_declare_parameters_from_overrides=True,
        )
        self.executor: Any = EventsExecutor(context=self.context)
        self.executor.add_node(self.node)

    def __enter__(self) -> Talker:
        return self

    def __exit__(self, *error: object) -> None:
        self.executor.remove_node(self.node)
        self.node.destroy_node()
        self.executor.shutdown()
        self.context.shutdown()

    def publishers(self, types: dict[str, str], qos: QoSProfile | int = 1000) -> dict[str, Any]:
        """Return publishers by topic once a recorder listens to all of them."""
        made = {
            topic: self.node.create_publisher(message_type(kind), topic, qos)
            for topic, kind in types.items()
        }
        wait_until(
            lambda: all(p.get_subscription_count() for p in made.values()), "the recorder to listen"
        )
        return made

    def collect(self, topic: str, kind: str, qos: QoSProfile | int = 10000) -> list[bytes]:
        """Subscribe; the serialized messages that arrive are appended to the returned list."""
        actual: list[bytes] = []
        self.node.create_subscription(message_type(kind), topic, actual.append, qos, raw=True)
        return actual

    def call(self, service_type: Any, name: str, request: Any) -> Any:
        """Call a service and return its response."""
        client = self.node.create_client(service_type, name)
        self.spin_until(client.service_is_ready, f"the service {name}")
        answer = self.spin_until(Question(client, request).answer, f"an answer of {name}")
        self.node.destroy_client(client)
        return answer

    def spin_until(self, condition: Callable[[], Any], what: str) -> Any:
        """Answer services until a condition is true."""
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            if value := condition():
                return value
            self.executor.spin_once(timeout_sec=0.02)
        raise AssertionError(f"waited {PATIENCE} s for {what}")


def publish(
    publishers: dict[str, Any], serialize: Callable[[str, int], bytes], ks: Iterable[int]
) -> None:
    """Publish message k on every topic."""
    for k in ks:
        for topic, publisher in publishers.items():
            publisher.publish(deserialize_message(serialize(topic, k), publisher.msg_type))
