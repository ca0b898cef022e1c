"""Access to the server: hosts, origins, the token, and the rights of the page itself. Pure."""

from __future__ import annotations

import base64
import hashlib
import hmac
import ipaddress
import re
import socket
from collections.abc import Collection
from dataclasses import dataclass
from http import HTTPStatus
from urllib.parse import parse_qs, urlsplit


@dataclass(frozen=True)
class Refusal:
    """The reason why a request is refused."""

    status: HTTPStatus
    reason: str


@dataclass(frozen=True)
class Access:
    """The rules."""

    token: str = ""
    """Token that permits to operate; empty: nobody may."""
    origins: Collection[str] = ()
    """Origins of the web pages, besides the server's own, that may connect."""
    host: str = ""
    """Address or name that the server listens on, by which it may be called."""

    def refuse_host(self, host: str | None) -> Refusal | None:
        """Refuse a request to a name that anybody could have pointed at this machine.

        A page of another site reaches a server on loopback as its own origin once its name resolves
        to 127.0.0.1 (DNS rebinding). So the host is an address, this machine, or allowed.
        """
        name = (urlsplit(f"//{host}").hostname or "") if _is_url(host) else ""
        local = {"localhost", socket.gethostname().lower(), self.host.lower()} - {""}
        allowed = {urlsplit(origin).hostname for origin in self.origins}
        if name in local | allowed or _is_address(name):
            return None
        return Refusal(
            HTTPStatus.MISDIRECTED_REQUEST,
            "this server answers to localhost, an address or this machine's name only",
        )

    def refuse_origin(self, origin: str | None, host: str | None) -> Refusal | None:
        """Refuse a web page of another server; only browsers name an origin."""
        own = (f"http://{host}", f"https://{host}")
        if origin is None or origin in self.origins or origin in own:
            return None
        return Refusal(
            HTTPStatus.FORBIDDEN,
            "a page of another origin: start the server with --allow-origin to let it in",
        )

    def may_operate(self, path: str) -> bool:
        """Return whether the sender of a path has the token; without it one only reads."""
        token = parse_qs(urlsplit(path).query).get("token", [""])[0] if _is_url(path) else ""
        return self.token != "" and hmac.compare_digest(token.encode(), self.token.encode())


def _is_url(text: str | None) -> bool:
    """Return whether a text can be read as an address."""
    if text is None or not re.fullmatch(r"[\x21-\x7e]+", text):
        return False
    try:
        urlsplit(text if "/" in text else f"//{text}")
    except ValueError:
        return False
    return True


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def page_headers(page: bytes, host: str) -> list[tuple[str, str]]:
    """Return the headers of the page: it runs only its own script and connects to its own server.

    ``host`` is that server as the browser calls it.
    """
    policy = {
        "default-src": "'none'",
        "script-src": _hashes(page, b"script"),
        "style-src": _hashes(page, b"style"),
        "connect-src": f"'self' ws://{host} wss://{host}",
        "img-src": "data: blob:",
        "base-uri": "'none'",
        "form-action": "'none'",
        "frame-ancestors": "'none'",  # or another page could lay itself over the buttons
    }
    return [
        ("Content-Type", "text/html; charset=utf-8"),
        ("Content-Security-Policy", "; ".join(f"{key} {value}" for key, value in policy.items())),
        ("X-Content-Type-Options", "nosniff"),
        ("Referrer-Policy", "no-referrer"),
        ("Cache-Control", "no-store"),
    ]


def _hashes(page: bytes, tag: bytes) -> str:
    """Return the sources of the inline elements of a kind."""
    elements = re.findall(rb"<%b(?:\s[^>]*)?>(.*?)</%b\s*>" % (tag, tag), page, re.DOTALL | re.I)
    digests = [base64.b64encode(hashlib.sha256(text).digest()).decode() for text in elements]
    return " ".join(f"'sha256-{digest}'" for digest in digests) or "'none'"
