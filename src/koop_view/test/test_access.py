"""Who is let in, and what the page may do in the browser."""

import base64
import hashlib

import pytest

from koop_view.access import Access, page_headers

RULES = Access("a-token-of-24-characters", ("https://app.foxglove.dev",))


@pytest.mark.parametrize(
    ("origin", "host", "let_in"),
    [
        (None, "127.0.0.1:8765", True),  # no browser
        ("http://127.0.0.1:8765", "127.0.0.1:8765", True),
        ("http://localhost:8765", "localhost:8765", True),
        ("http://[::1]:8765", "[::1]:8765", True),
        ("https://app.foxglove.dev", "127.0.0.1:8765", True),  # allowed
        ("http://127.0.0.1:8000", "127.0.0.1:8765", False),  # another server of this machine
        ("http://localhost:8765", "127.0.0.1:8765", False),
        ("http://evil.example", "127.0.0.1:8765", False),
        ("http://127.0.0.1:8765.evil.example", "127.0.0.1:8765", False),
        ("http://evil.example/http://127.0.0.1:8765", "127.0.0.1:8765", False),
        ("null", "127.0.0.1:8765", False),  # a file, or a frame in a sandbox
        ("", "127.0.0.1:8765", False),
        ("http://[", "127.0.0.1:8765", False),
    ],
)
def test_only_the_own_page_and_what_is_allowed_connects(origin, host, let_in):
    assert (RULES.refuse_origin(origin, host) is None) == let_in


@pytest.mark.parametrize(
    ("host", "let_in"),
    [
        ("127.0.0.1:8765", True), ("localhost:9000", True), ("192.168.0.7:8765", True),
        ("[::1]:8765", True), ("app.foxglove.dev", True),
        ("evil.example:8765", False),  # resolves to 127.0.0.1 by now
        ("", False), (None, False), ("127.0.0.1.evil.example", False), ("[::1", False),
        ("127.0.0.1 evil.example", False),
    ],
)  # fmt: skip
def test_a_name_that_anybody_could_point_here_is_refused(host, let_in):
    assert (RULES.refuse_host(host) is None) == let_in


def test_the_name_that_it_listens_on_is_answered():
    """``koop serve`` prints it as the page's address."""
    assert Access(host="Rig.lab").refuse_host("rig.lab:8765") is None
    assert Access(host="").refuse_host("") is not None


def test_only_the_token_lets_operate():
    assert RULES.may_operate("/?token=a-token-of-24-characters")
    for path in (
        "/",
        "/?token=wrong",
        "/?token=\x00",
        "/?token=%C3%A4",
        "/?token=a-token-of-24-character",
    ):
        assert not RULES.may_operate(path)
    assert not Access("").may_operate("/?token=anything")
    assert not Access("").may_operate("/?token=")


def test_the_page_runs_its_own_script_and_speaks_with_its_own_server_only():
    page = b"<html><script>one()</script><SCRIPT defer>two()</SCRIPT ><style>p{}</style>"
    policy = dict(page_headers(page, "127.0.0.1:1"))["Content-Security-Policy"]
    rules = dict(rule.split(" ", 1) for rule in policy.split("; "))
    digests = [base64.b64encode(hashlib.sha256(s).digest()).decode() for s in (b"one()", b"two()")]
    assert rules["script-src"] == " ".join(f"'sha256-{digest}'" for digest in digests)
    assert rules["connect-src"] == "'self' ws://127.0.0.1:1 wss://127.0.0.1:1"
    assert rules["default-src"] == rules["frame-ancestors"] == "'none'"
    assert "unsafe" not in policy
