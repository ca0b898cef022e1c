"""The server: one port that gives the page to browsers and the protocol to WebSockets."""

from __future__ import annotations

import asyncio
import errno
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from http import HTTPStatus
from importlib.resources import files

from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from koop_core.config.parameter import ConfigError
from koop_view import protocol
from koop_view.access import Access, Refusal, page_headers
from koop_view.config import ViewConfig
from koop_view.session import ClientSession, ViewSource

CLIENTS = 16  # at a time
LONGEST_MESSAGE = 256 * 1024  # [B] of a client
CHECK_PERIOD = 0.1  # [s] between looks for slow clients
OPEN_TIMEOUT = 5.0  # [s] for a request to be complete

_silent = logging.getLogger("koop_view.websockets")  # hostile requests would fill the log
_silent.setLevel(logging.CRITICAL + 1)


class ViewServer:
    """Serves a source; without a token nobody may operate it."""

    def __init__(self, source: ViewSource, config: ViewConfig, token: str) -> None:
        self._source = source
        self._config = config
        self._access = Access(token, frozenset(config.origins), config.host)
        self._page = (files("koop_view") / "page" / "index.html").read_bytes()

    @asynccontextmanager
    async def listen(self) -> AsyncIterator[int]:
        """Serve while the context lasts; it gives the port.

        Raises
        ------
        ConfigError
            If the address cannot be had.
        """
        try:
            server = await serve(
                self._serve_client,
                self._config.host,
                self._config.port,
                process_request=self._decide,
                subprotocols=[Subprotocol(name) for name in protocol.SUBPROTOCOLS],
                compression=None,  # it would cost the machine of the loop time
                server_header=None,
                open_timeout=OPEN_TIMEOUT,
                close_timeout=2.0,
                max_size=LONGEST_MESSAGE,
                max_queue=16,
                write_limit=64 * 1024,
                logger=_silent,
            )
        except UnicodeError:  # of what looks up names
            raise ConfigError(f"'{self._config.host}' is not an address or a name") from None
        except OSError as error:
            where = f"{self._config.host} port {self._config.port}"
            if error.errno == errno.EADDRINUSE:
                raise ConfigError(f"{where} is taken: choose another one, or 0 for any") from None
            raise ConfigError(f"cannot listen on {where}: {error.strerror or error}") from None
        check = asyncio.create_task(self._watch_backlogs())
        try:
            yield int(next(iter(server.sockets)).getsockname()[1])
        finally:
            check.cancel()
            server.close(code=1001, reason="the server ends")
            await server.wait_closed()

    def _decide(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer a request, or let it become a WebSocket."""
        host, origin = _one(request.headers, "Host"), _one(request.headers, "Origin")
        refused = self._access.refuse_host(host)
        if refused is None and _one(request.headers, "Upgrade").lower() != "websocket":
            return self._give_page(request.path, host)
        refused = refused or self._access.refuse_origin(origin or None, host)
        if len(self._source.sessions) >= CLIENTS:
            refused = refused or Refusal(
                HTTPStatus.SERVICE_UNAVAILABLE, f"there are {CLIENTS} clients already"
            )
        if refused is None:
            return None
        peer = (connection.remote_address or "?")[0]
        whence = f", origin {origin[:100]!r}" if origin else ""
        self._source.log_refusal(f"refused: {peer}{whence}: {refused.reason}")
        return _response(refused.status, [], (refused.reason + "\n").encode())

    def _give_page(self, path: str, host: str) -> Response:
        if path.partition("?")[0] not in ("/", "/index.html"):
            return _response(HTTPStatus.NOT_FOUND, [], b"there is only /\n")
        return _response(HTTPStatus.OK, page_headers(self._page, host), self._page)

    async def _serve_client(self, connection: ServerConnection) -> None:
        source = self._source
        request = connection.request
        operates = request is not None and self._access.may_operate(request.path)
        session = ClientSession(connection, source, operates)
        source.sessions.add(session)
        try:
            session.send(source.info(session.operates))
            session.send(protocol.advertise(source.channels.values()))
            session.send_services(source.services.values())
            async for message in connection:
                session.receive(message)
        except ConnectionClosed:
            pass
        finally:
            source.sessions.discard(session)
            session.close()

    async def _watch_backlogs(self) -> None:
        while True:
            await asyncio.sleep(CHECK_PERIOD)
            for session in list(self._source.sessions):
                session.check_backlog()


def _one(headers: Headers, name: str) -> str:
    """Return a header; one that is there more than once cannot be used."""
    values = headers.get_all(name)
    return values[0] if len(values) == 1 else " ".join(values)


def _response(status: HTTPStatus, headers: list[tuple[str, str]], body: bytes) -> Response:
    """Return an HTTP response, after which the connection is closed."""
    headers = headers or [("Content-Type", "text/plain; charset=utf-8")]
    headers = [*headers, ("Content-Length", str(len(body))), ("Connection", "close")]
    return Response(status.value, status.phrase, Headers(headers), body)
