"""A page in headless Chromium that goes on: looked at and operated over the DevTools protocol."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import time
import urllib.request
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from websockets.sync.client import connect

TIMEOUT = 120.0  # [s]; on a busy machine a node takes a minute to start


class _PageLeft(Exception):
    """The page was left, or loaded anew, before it could answer."""

    message = "Inspected target navigated or closed"


class Chromium:
    """A browser with one page; a context manager.

    Parameters
    ----------
    folder : Path
        Of its profile.
    url : str
        Of the page.
    """

    def __init__(self, folder: Path, url: str) -> None:
        browser = os.environ.get("CHROMIUM") or shutil.which("chromium")
        if browser is None:
            pytest.skip("no Chromium: `./koop test` says how to get one")
        self.errors: list[str] = []
        """What the console says is wrong."""
        self._number = 0
        self._process = subprocess.Popen(
            [browser, "--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0",
             "--disable-background-networking", f"--user-data-dir={folder / 'profile'}",
             "--window-size=1400,1000", "about:blank"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            env={**os.environ, "HOME": str(folder)},
        )  # fmt: skip
        port_file = folder / "profile" / "DevToolsActivePort"
        self._until(lambda: port_file.is_file() and port_file.read_text().count("\n"), "Chromium")
        port = port_file.read_text().splitlines()[0]
        targets = json.load(urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list"))
        page = next(item for item in targets if item["type"] == "page")
        self._connection = connect(page["webSocketDebuggerUrl"], max_size=None, proxy=None)
        for domain in ("Runtime", "Log", "Page"):
            self._command(f"{domain}.enable")
        self.open(url)

    def __enter__(self) -> Chromium:
        return self

    def __exit__(self, *error: object) -> None:
        self._connection.close()
        self._process.terminate()
        self._process.wait(TIMEOUT)

    def open(self, url: str) -> None:
        """Leave the page for another one."""
        self._command("Page.navigate", url=url)

    def value(self, expression: str) -> Any:
        """Return the value of an expression of JavaScript."""
        answer = self._command("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait(self, expression: str, timeout: float = TIMEOUT, pause: float = 0.02) -> Any:
        """Look every so often [s] until an expression is true, and return it.

        While the page is left for another, or loaded anew, it is not.
        """

        def look() -> Any:
            with suppress(_PageLeft):
                return self.value(expression)

        return self._until(look, expression, timeout, pause)

    def memory(self) -> int:
        """Return the bytes that the page's script holds, after a collection."""
        self._command("HeapProfiler.collectGarbage")
        used = self._command("Runtime.getHeapUsage")
        return int(used["usedSize"] + used.get("backingStorageSize", 0))

    def resize(self, width: int, height: int) -> None:
        """Give the page another size."""
        self._command("Emulation.setDeviceMetricsOverride", width=width, height=height,
                      deviceScaleFactor=1, mobile=width < 500)  # fmt: skip

    def picture(self, path: Path) -> None:
        """Save what the page looks like."""
        path.write_bytes(base64.b64decode(self._command("Page.captureScreenshot")["data"]))

    def _command(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        self._connection.send(
            json.dumps({"id": self._number, "method": method, "params": parameters})
        )
        while True:
            said = json.loads(self._connection.recv(TIMEOUT))
            if said.get("id") == self._number:
                if said.get("error", {}).get("message") == _PageLeft.message:
                    raise _PageLeft
                assert "error" not in said, said
                return dict(said["result"])
            self._note(said)

    def _note(self, said: dict[str, Any]) -> None:
        content = said.get("params", {})
        if said.get("method") == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(content["exceptionDetails"])[:500])
        elif said.get("method") == "Log.entryAdded" and content["entry"]["level"] == "error":
            self.errors.append(content["entry"]["text"])
        elif said.get("method") == "Runtime.consoleAPICalled" and content["type"] == "error":
            self.errors.append(json.dumps(content["args"])[:500])

    @staticmethod
    def _until(condition: Any, what: str, timeout: float = TIMEOUT, pause: float = 0.02) -> Any:
        deadline = time.monotonic() + timeout
        while not (actual := condition()):
            if time.monotonic() > deadline:
                pytest.fail(f"timed out after {timeout:g} s: {what}")
            time.sleep(pause)
        return actual
