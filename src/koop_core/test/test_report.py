"""Which findings become lines of the log."""

from koop_core.stream.report import ERROR, OK, STALE, WARN, News, NodeFinding
from koop_core.stream.settings import STREAM


def lines(levels):
    """Return the levels that are logged, one look a second."""
    news = News()
    reported = [news.of(NodeFinding(level, "text"), float(t)) for t, level in enumerate(levels)]
    return [item.level if item else None for item in reported]


def test_what_gets_worse_is_told_at_once_and_once():
    assert lines([OK, WARN, WARN, STALE, STALE, ERROR, ERROR]) == [
        None, WARN, None, STALE, None, ERROR, None
    ]  # fmt: skip


def test_what_may_be_so_at_every_start_is_told_when_it_has_lasted():
    news, actual = News(), NodeFinding(WARN, "nothing yet", at_once=False)
    reported = [news.of(actual, float(t)) for t in range(int(STREAM.settled) + 2)]
    assert [item is not None for item in reported] == [*[False] * int(STREAM.settled), True, False]
    short = News()
    assert not any(
        short.of(item, float(t)) for t, item in enumerate([actual, actual, NodeFinding(OK, "")])
    )


def test_a_recovery_is_told_when_it_has_lasted():
    quiet = int(STREAM.settled)
    assert lines([WARN, *[OK] * (quiet + 2)]) == [WARN, *[None] * quiet, OK, None]


def test_a_warning_that_comes_and_goes_is_one_line():
    flapping = [WARN, OK, OK] * 30
    assert [level for level in lines([*flapping, *[OK] * 10]) if level is not None] == [WARN, OK]


def test_an_error_that_becomes_a_warning_is_told_as_a_warning():
    reported = lines([ERROR, *[WARN] * 7, OK, OK])
    assert [level for level in reported if level is not None] == [ERROR, WARN]
