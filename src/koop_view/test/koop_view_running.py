"""A server that runs in a thread, and clients of it."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from koop_view.config import ViewConfig
from koop_view.protocol import SUBPROTOCOLS
from koop_view.server import ViewServer
from koop_view.session import ViewSource

TIMEOUT = 120.0  # [s]; nothing takes this long if all is well


@contextmanager
def running(source: ViewSource, token: str = "", **options: Any) -> Iterator[int]:
    """Run a server of a source; give its port."""
    ready: threading.Event = threading.Event()
    server: dict[str, Any] = {}

    async def work() -> None:
        server["stop"], server["loop"] = asyncio.Event(), asyncio.get_running_loop()
        config = ViewConfig(**{"port": 0, **options})
        async with ViewServer(source, config, token).listen() as port:
            server["port"] = port
            ready.set()
            await server["stop"].wait()

    thread = threading.Thread(target=lambda: asyncio.run(work()))
    thread.start()
    assert ready.wait(10)
    try:
        yield server["port"]
    finally:
        server["loop"].call_soon_threadsafe(server["stop"].set)
        thread.join()


def client(port: int, token: str = "", **options: Any) -> ClientConnection:
    """Connect as a program that is not a browser."""
    query = f"?token={token}" if token else ""
    options.setdefault("subprotocols", SUBPROTOCOLS[:1])
    return connect(
        f"ws://127.0.0.1:{port}/{query}", max_size=None, compression=None, proxy=None, **options
    )


def heard(connection: ClientConnection, operation: str) -> dict[str, Any]:
    """Return the next message of an operation; pass over others."""
    while True:
        message = connection.recv(TIMEOUT)
        if isinstance(message, str) and json.loads(message)["op"] == operation:
            return json.loads(message)


def tell(connection: ClientConnection, operation: str, **content: Any) -> None:
    """Send a message."""
    connection.send(json.dumps({"op": operation, **content}))


def closed_with(connection: ClientConnection) -> tuple[int, str]:
    """Read until the server closes; return its code and reason."""
    with suppress(ConnectionClosed):
        while True:
            connection.recv(10)
    return connection.close_code or 0, connection.close_reason or ""
