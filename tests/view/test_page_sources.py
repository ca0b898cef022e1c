"""The pages of koop_view: the checked-in files are built from their sources, and work."""

import fcntl
import hashlib
import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

ROOT = Path(__file__).parents[2]
WEB = ROOT / "src" / "koop_view" / "web"
PAGES = [
    ROOT / "src" / "koop_view" / "koop_view" / "page" / f"{n}.html" for n in ("index", "report")
]
GOLDEN = ROOT / "recordings" / "golden" / "run" / "bag"
NO_NETWORK = re.compile("ENOTFOUND|EAI_AGAIN|ECONNREFUSED|ECONNRESET|ETIMEDOUT|ENETUNREACH")
BUILD = "cd src/koop_view/web && npm ci && npm run build"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_was_made_of_the_sources_that_are_here(page):
    sources = [f"src/{path.name}" for path in (WEB / "src").iterdir()]
    digest = hashlib.sha256()
    for name in sorted(["build.mjs", "package-lock.json", *sources]):
        digest.update(f"{name}\n".encode() + (WEB / name).read_bytes())
    named = re.search('name="sources" content="([0-9a-f]*)"', page.read_text(encoding="utf-8"))
    assert named, f"the page does not name its sources: {BUILD}"
    assert named[1] == digest.hexdigest(), f"the page is older than its sources: {BUILD}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_needs_no_network(page):
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"<(script|link|img|iframe)[^>]*(src|href)=(?!\"data:)", text)
    assert not re.search(r"@import|url\((?!data:)", text)
    assert not re.search(r"[^.\w](eval|Function|importScripts)\(|\bimport\(", text)


@pytest.fixture(scope="module")
def web():
    """Return the folder of the sources, with the packages that they need, installed once."""
    if not (shutil.which("node") and shutil.which("npm")):
        pytest.skip("the pages are built with Node.js and npm, which are not installed")
    lock, installed = WEB / "package-lock.json", WEB / "node_modules" / ".installed"
    with (WEB / ".npm.lock").open("w") as guard:  # tests run side by side
        fcntl.flock(guard, fcntl.LOCK_EX)
        if not (installed.is_file() and installed.read_bytes() == lock.read_bytes()):
            install = ["npm", "ci", "--no-audit", "--no-fund", "--ignore-scripts",
                       "--prefer-offline"]  # fmt: skip
            done = subprocess.run(install, cwd=WEB, capture_output=True, text=True, check=False)
            if done.returncode and NO_NETWORK.search(done.stderr):
                pytest.skip("npm could not install what builds the pages: there is no network")
            assert done.returncode == 0, done.stderr
            shutil.copy(lock, installed)
    return WEB


def run(web, *command, **more_environment):
    environment = {**os.environ, **more_environment}
    done = subprocess.run(
        command, cwd=web, capture_output=True, text=True, check=False, env=environment
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_sources_are_formatted_and_have_the_types_they_say(web):
    command = ["npm", "run", "check"]
    done = subprocess.run(command, cwd=web, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_sources_give_the_pages_byte_for_byte(web, tmp_path):
    run(web, "node", "build.mjs", "--out", str(tmp_path))
    for page in PAGES:
        assert (tmp_path / page.name).read_bytes() == page.read_bytes(), BUILD


def simple(value):
    """Return a message of `rosbags` in the terms of JSON."""
    if hasattr(value, "__dataclass_fields__"):
        names = (name for name in value.__dataclass_fields__ if name != "__msgtype__")
        return {n: simple(getattr(value, n)) for n in names if not n.isupper()}
    if isinstance(value, (np.ndarray, list)):
        return [simple(item) for item in value]
    if isinstance(value, (bytes, bytearray)):
        return list(value)
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, float) and not np.isfinite(value):
        return {"nan": "NaN", "inf": "Infinity", "-inf": "-Infinity"}[str(value)]
    return value


def test_the_logic_of_the_page(web, tmp_path):
    """Run the page's own tests; what it decodes is what `rosbags` finds in the golden bag."""
    topics = {"/state", "/cost", "/theta", "/diagnostics", "/rosout"}
    lines = []
    with AnyReader([GOLDEN]) as bag:
        used = [item for item in bag.connections if item.topic in topics]
        schemas = {item.msgtype: item.msgdef.data for item in used}
        lines.append({"schemas": schemas})
        for connection, _, raw in bag.messages(connections=used):
            values = simple(bag.deserialize(raw, connection.msgtype))
            options = {"topic": connection.topic, "type": connection.msgtype, "hex": raw.hex()}
            lines.append(options | {"values": values})
    messages = tmp_path / "messages.jsonl"
    messages.write_text("\n".join(map(json.dumps, lines)), encoding="utf-8")
    bundle = tmp_path / "tests"
    run(web, "node", "build.mjs", "--tests", str(bundle))
    report = run(web, "node", "--test", str(bundle), KOOP_MESSAGES=str(messages))
    assert re.search(r"^# pass (?!0$)\d+$", report, re.M)
    assert re.search(r"^# skipped 0$", report, re.M), report
