"""Runs the server until it is told to stop, and prints its address. Pure."""

from __future__ import annotations

import asyncio
import ipaddress
import secrets
import signal
import socket
from collections.abc import Callable, Coroutine
from typing import Any

from koop_core.config.parameter import ConfigError
from koop_view.config import ADDRESS, ViewConfig
from koop_view.session import ViewSource


def address(config: ViewConfig, port: int) -> str:
    """Return the page's address as a browser takes it."""
    host = config.host
    if host in ("0.0.0.0", "::", ""):
        host = socket.gethostname()
    elif ":" in host:
        host = f"[{host}]"
    return f"http://{host}:{port}/"


def is_loopback(host: str) -> bool:
    """Return whether only this machine reaches an address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


async def serve(
    source: ViewSource,
    config: ViewConfig,
    update: Callable[[], Coroutine[Any, Any, Any]] | None = None,
) -> None:
    """Serve a source until SIGINT, SIGTERM or SIGHUP; ``update`` keeps it up to date meanwhile.

    The failure of the update ends the server.
    """
    try:
        from koop_view.server import ViewServer
    except ImportError as error:  # what Ubuntu 24.04 has is too old
        raise ConfigError(
            f"the page needs websockets 14 or newer ({error}): pip install websockets"
        ) from None

    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        loop.add_signal_handler(number, stop.set)
    token = secrets.token_urlsafe(24) if config.operate else ""
    async with ViewServer(source, config, token).listen() as port:
        page = address(config, port)
        print(f"{ADDRESS}{page}{f'#token={token}' if token else ''}")
        if token:
            print(f"with that address anybody may operate the loop; {page} reads only")
        if not is_loopback(config.host):
            print("it is open to the network, without encryption: docs/how-to/secure-a-loop.md")
        print("Ctrl-C ends it", flush=True)
        tasks = [asyncio.create_task(work()) for work in (stop.wait, update) if work is not None]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            for task in tasks:
                task.cancel()
