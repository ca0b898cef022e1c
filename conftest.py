"""For all tests: interrupts interrupt, a ROS domain of one's own, no skip that nobody notices."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path

import pytest

from koop_node.client.client import Client
from koop_node.process.domain import hold_domain

ROOT = Path(__file__).parent
ALLOWED_SKIPS = ROOT / "tests" / "allowed_skips.txt"

gc.disable()  # until all that tests import is there

# A script starts what it sends to the background with SIGINT ignored, and every process under it
# inherits that: the tests of Ctrl-C would wait for ever.
signal.signal(signal.SIGINT, signal.default_int_handler)

LONG = ("tests/commission/test_guard.py", "tests/commission/", "tests/", "src/koop_study/",
        "src/koop_tune/", "src/koop_bag/")  # fmt: skip

NO_DOMAIN = "none: the test is not marked 'ros'"  # with which no node can start
os.environ["ROS_DOMAIN_ID"] = NO_DOMAIN
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
# The matrices are small: more threads spin on processors that other tests and rigs need.
os.environ["OPENBLAS_NUM_THREADS"] = "1"


@pytest.hookimpl(optionalhook=True)  # there may be no xdist
def pytest_xdist_auto_num_workers() -> int:
    """Two workers a processor: most tests wait for their nodes half of the time."""
    return 2 * len(os.sched_getaffinity(0))


@pytest.fixture(scope="session")
def hears_by_udp() -> None:
    """Let this process hear by UDP, whichever test is its first one: Fast DDS reads that once.

    A node that a test stops may hold the lock of a mailbox in shared memory; all who send to it
    then wait for seconds.
    """
    with hold_domain() as domain, Client("client", domain):
        pass


@pytest.fixture(scope="module")
def module_domain(hears_by_udp: None) -> Iterator[str]:
    """Give the tests of a module one domain, for nodes that several of them use."""
    with hold_domain() as domain, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(domain))
        yield str(domain)


@pytest.fixture
def own_domain(hears_by_udp: None, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Give a test a domain, for nodes that only it uses."""
    with hold_domain() as domain:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        yield


@pytest.fixture(autouse=True)
def domain_of_the_marked(request: pytest.FixtureRequest) -> None:
    """Give a domain to what is marked 'ros'."""
    if request.node.get_closest_marker("ros") and "module_domain" not in request.fixturenames:
        request.getfixturevalue("own_domain")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what asks for a domain; the long files come first."""
    items.sort(key=lambda item: [not item.nodeid.startswith(start) for start in LONG])
    for item in items:
        if {"own_domain", "module_domain"} & set(getattr(item, "fixturenames", ())):
            item.add_marker("ros")


def pytest_collection_finish() -> None:
    """Take the tests and all that they import out of every later collection of garbage."""
    gc.freeze()
    gc.enable()


def allowed_skips() -> list[str]:
    """Return the patterns of test ids, one a line before the colon and the reason."""
    lines = ALLOWED_SKIPS.read_text(encoding="utf-8").splitlines()
    return [line.split(": ")[0] for line in lines if line and not line.startswith("#")]


def refuse_skip(report: pytest.TestReport | pytest.CollectReport) -> None:
    """In continuous integration turn a skip into a failure, unless it is on the list."""
    if not report.skipped or hasattr(report, "wasxfail") or not os.environ.get("CI"):
        return
    if not any(fnmatch(report.nodeid, pattern) for pattern in allowed_skips()):
        report.outcome = "failed"
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr
        report.longrepr = f"{reason}\nA skip fails where CI is set: see {ALLOWED_SKIPS.name}."


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Iterator[None]:
    report = yield
    refuse_skip(report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Iterator[None]:
    report = yield
    refuse_skip(report)
    return report
