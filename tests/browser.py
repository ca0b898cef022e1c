"""A page in headless Chromium: what it looks like and does there."""

from __future__ import annotations

import html
import json
import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

FRAME = Path(__file__).with_name("frame.html")


def browse(
    page: str, width: int, folder: Path, dark: bool = False
) -> tuple[dict[str, Any], list[str]]:
    """Open a page in a frame of ``width``; return its state and the console's errors."""
    browser = os.environ.get("CHROMIUM") or shutil.which("chromium")
    if browser is None:
        pytest.skip("no Chromium: `./koop test` says how to get one")
    path = folder / "frame.html"
    frame = FRAME.read_text(encoding="utf-8").replace("WIDTH", str(width))
    path.write_text(frame.replace("PAGE", html.escape(page)), encoding="utf-8")
    done = subprocess.run(
        [browser, "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr",
         "--disable-background-networking", f"--user-data-dir={folder / 'profile'}",
         "--virtual-time-budget=10000", f"--blink-settings=preferredColorScheme={int(not dark)}",
         "--window-size=1400,1000", "--dump-dom", path.as_uri()],
        capture_output=True, text=True, check=False, timeout=240,
        env={**os.environ, "HOME": str(folder)},
    )  # fmt: skip
    actual = re.search(r'data-result="([^"]*)"', done.stdout)
    assert actual, done.stderr[-2000:]
    errors = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return json.loads(html.unescape(actual[1])), errors
