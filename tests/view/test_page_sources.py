"""The operator's page: the checked-in file is what its sources give, and its logic is right."""

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
PAGE = ROOT / "src" / "koop_view" / "koop_view" / "page" / "index.html"
HOUSE = ROOT / "src" / "koop_lab" / "koop_lab" / "page" / "page.css"
GOLDEN = ROOT / "recordings" / "golden" / "run" / "bag"
NO_NETWORK = re.compile("ENOTFOUND|EAI_AGAIN|ECONNREFUSED|ECONNRESET|ETIMEDOUT|ENETUNREACH")
BUILD = "cd src/koop_view/web && npm ci && npm run build"


def test_the_page_was_made_of_the_sources_that_are_here():
    own = [
        "build.mjs",
        "package-lock.json",
        *(f"src/{path.name}" for path in (WEB / "src").iterdir()),
    ]
    found = hashlib.sha256()
    for name in sorted(own):
        found.update(f"{name}\n".encode() + (WEB / name).read_bytes())
    found.update(b"page.css\n" + HOUSE.read_bytes())
    named = re.search('name="sources" content="([0-9a-f]*)"', PAGE.read_text(encoding="utf-8"))
    assert named, f"the page does not name its sources: {BUILD}"
    assert named[1] == found.hexdigest(), f"the page is older than its sources: {BUILD}"


def test_the_page_needs_no_network():
    page = PAGE.read_text(encoding="utf-8")
    assert not re.search(r"<(script|link|img|iframe)[^>]*(src|href)=(?!\"data:)", page)
    assert not re.search(r"@import|url\((?!data:)", page)
    assert not re.search(r"[^.\w](eval|Function|importScripts)\(|\bimport\(", page)


@pytest.fixture(scope="module")
def web(tmp_path_factory):
    """Return a copy of the sources with the packages that they need."""
    if not (shutil.which("node") and shutil.which("npm")):
        pytest.skip("the page is built with Node.js and npm, which are not installed")
    folder = tmp_path_factory.mktemp("web") / "web"
    shutil.copytree(WEB, folder, ignore=shutil.ignore_patterns("node_modules"))
    install = ["npm", "ci", "--no-audit", "--no-fund", "--ignore-scripts", "--prefer-offline"]
    done = subprocess.run(install, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode and NO_NETWORK.search(done.stderr):
        pytest.skip("npm could not install what the page is built with: there is no network")
    assert done.returncode == 0, done.stderr
    return folder


def run(web, *command, **more_environment):
    environment = {**os.environ, "KOOP_PAGE_CSS": str(HOUSE), **more_environment}
    done = subprocess.run(
        command, cwd=web, capture_output=True, text=True, check=False, env=environment
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_sources_give_the_page_byte_for_byte(web):
    run(web, "node", "build.mjs", "--out", "built.html")
    assert (web / "built.html").read_bytes() == PAGE.read_bytes(), BUILD


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
            given = {"topic": connection.topic, "type": connection.msgtype, "hex": raw.hex()}
            lines.append(given | {"values": values})
    messages = tmp_path / "messages.jsonl"
    messages.write_text("\n".join(map(json.dumps, lines)), encoding="utf-8")
    built = tmp_path / "tests"
    run(web, "node", "build.mjs", "--tests", str(built))
    said = run(web, "node", "--test", str(built), KOOP_MESSAGES=str(messages))
    assert re.search(r"^# pass (?!0$)\d+$", said, re.M)
    assert re.search(r"^# skipped 0$", said, re.M), said
