"""Where a running loop answers the programs of its machine: at the name that holds its place.

A question is one packet, ``status`` or ``stop``; the answer is one packet of JSON. The kernel
says which program asks. Linux only, and pure: no ROS.
"""

from __future__ import annotations

import json
import os
import re
import socket
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from koop_core.errors import LiveError
from koop_node.client.alone import PREFIX

STATUS, STOP = "status", "stop"
MOST = 16  # that are answered at a time, and that may be connected without a question
LONGEST = 65536  # [B] of an answer
PATIENCE = 5.0  # [s] for an answer to ``status``
_OF_LOOP = re.compile(rf"{PREFIX}[0-9]{{1,3}}(/[A-Za-z0-9_]+)*")
_CREDENTIALS = struct.Struct("3i")  # of unix(7): process, user, group


class Desk:
    """Answers between two steps of a loop, and waits for nobody.

    ``place`` is of :func:`koop_node.client.alone.alone`.
    """

    def __init__(self, place: socket.socket) -> None:
        place.listen(MOST)
        place.setblocking(False)
        self._place = place
        self._asking: list[socket.socket] = []
        self._waiting: list[socket.socket] = []
        """Programs that asked to stop and wait for the end."""

    def answer(self, describe: Callable[[], dict[str, Any]]) -> bool:
        """Answer all that asked; return whether one that may do so asked to stop."""
        with suppress(BlockingIOError):
            for _ in range(MOST):
                asking, _ = self._place.accept()
                asking.setblocking(False)
                self._asking.append(asking)
        stop = False
        for asking in list(self._asking):
            try:
                question = asking.recv(64).decode(errors="replace")
            except BlockingIOError:
                continue
            except OSError:
                question = ""
            self._asking.remove(asking)
            if question == STOP and credentials(asking)[1] in (0, os.geteuid()):
                self._waiting.append(asking)
                stop = True
            else:
                refused = {"refused": "its user or root may stop it"}
                _say(asking, describe() if question == STATUS else refused)
        for silent in self._asking[:-MOST]:  # the oldest: they keep nobody out
            silent.close()
        del self._asking[:-MOST]
        return stop

    def close(self, words: str) -> None:
        """Tell the programs that wait for the end what it left behind."""
        for asking in self._waiting:
            _say(asking, {"text": words})
        for asking in self._asking:
            asking.close()
        self._asking, self._waiting = [], []


def _say(asking: socket.socket, answer: dict[str, Any]) -> None:
    with suppress(OSError), asking:  # it may have gone
        asking.send(json.dumps(answer).encode())


def credentials(peer: socket.socket) -> tuple[int, int]:
    """Return process and user at the other end, as the kernel knows them."""
    data = peer.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    process, user, _ = _CREDENTIALS.unpack(data)
    return process, user


def find_loops() -> list[str]:
    """Return the names of the loops of this machine, as ``koop/DOMAIN/NAMESPACE``.

    Any program may take a name that begins so: one that no loop has is left out.
    """
    lines = Path("/proc/net/unix").read_text().splitlines()[1:]
    names = {line.rpartition(" @")[2] for line in lines if f" @{PREFIX}" in line}
    return sorted(name for name in names if _OF_LOOP.fullmatch(name))


def ask(name: str, question: str, patience: float | None = PATIENCE) -> dict[str, Any]:
    """Ask a loop of :func:`find_loops`, and return its answer, with its ``pid`` and ``user``.

    ``stop`` is answered at the end. Raises LiveError if it does not answer in time [s]; None: any.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as loop:
        loop.settimeout(patience)
        process = user = 0
        try:
            _connect(loop, f"\0{name}", patience)
            process, user = credentials(loop)
            loop.send(question.encode())
            data = loop.recv(LONGEST)
        except ConnectionRefusedError:
            raise LiveError(
                "does not answer: it is starting, or of ros2 launch: look at its own terminal"
            ) from None
        except TimeoutError:
            raise LiveError(f"process {process}: hangs: no answer in {patience:g} s") from None
        except OSError as error:
            raise LiveError(f"does not answer: {error}") from None
    if not data:
        raise LiveError("ended without a word: theta is left to guard and twin, see its logs")
    answer = _parse(data)
    status = isinstance(answer.get("places"), list) and answer.keys() >= {"healthy", "text"}
    if not (status if question == STATUS else answer.keys() & {"text", "refused"}):
        raise LiveError(f"process {process}: its answer is not one of a loop of this version")
    return {**answer, "pid": process, "user": user}


def _parse(data: bytes) -> dict[str, Any]:
    """Return an answer; an empty one of what is none."""
    try:
        return dict(json.loads(data))
    except (ValueError, TypeError):
        return {}


def _connect(loop: socket.socket, address: str, patience: float | None) -> None:
    """Connect, also where more programs connect at a time than the loop lets wait."""
    deadline = time.monotonic() + (patience or 0.0)
    while True:
        try:
            loop.connect(address)
            return
        except BlockingIOError:  # the timeout of a socket does not cover this
            if time.monotonic() > deadline:
                raise
            time.sleep(0.01)
