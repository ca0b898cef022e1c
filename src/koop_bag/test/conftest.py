"""Bags made of real messages."""

from __future__ import annotations

import random
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from koop_bag.bag.writer import BagWriter, WriterOptions
from koop_bag.cdr.schema import load_schema
from koop_node.process.domain import hold_domain

sys.path.insert(0, str(Path(__file__).parent))  # helpers of these tests; pytest adds no folder

from koop_bag_messages import LOOP, PERIOD, START, Messages


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "ros: starts ROS 2 nodes")


@pytest.fixture(autouse=True)
def domain_of_the_marked(request: pytest.FixtureRequest) -> Iterator[None]:
    """Give a domain to each test of nodes: the ghost of a killed one is a listener for 20 s."""
    if not request.node.get_closest_marker("ros"):
        yield
        return
    with hold_domain() as domain, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(domain))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield


@pytest.fixture(scope="session")
def messages() -> Messages:
    return Messages()


@pytest.fixture
def write_loop(tmp_path: Path, messages: Messages) -> Callable[..., Path]:
    """Return a function that writes a bag of the loop's four topics."""

    def write(name: str = "run", n: int = 100, **options: Any) -> Path:
        folder = tmp_path / name
        with BagWriter(folder, WriterOptions(**options)) as writer:
            channels = {t: writer.add_topic(t, load_schema(kind)) for t, kind in LOOP.items()}
            for k in range(n):
                for i, (topic, channel) in enumerate(channels.items()):
                    now = START + k * PERIOD + 1000 * i
                    writer.write(channel, now, now - 500, messages.loop(topic, k))
        return folder

    return write


@pytest.fixture
def rng() -> random.Random:
    return random.Random(7)
