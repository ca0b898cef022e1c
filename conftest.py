"""For all tests: interrupts interrupt, a domain of one's own, and no skip that nobody notices."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path

import pytest

from koop_node.domain import free_domain

ALLOWED_SKIPS = Path(__file__).parent / "tests" / "allowed_skips.txt"

# A script starts what it sends to the background with SIGINT ignored, and every process under it
# inherits that: the tests of Ctrl-C would wait for ever.
signal.signal(signal.SIGINT, signal.default_int_handler)

# A loop that runs beside the tests must not be disturbed.
os.environ["ROS_DOMAIN_ID"] = str(free_domain())
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"


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
