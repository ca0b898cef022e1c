"""Bags in an object store: the same answers as from the disk, no byte asked for twice."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from koop_bag.mcap import stored_file
from koop_lab.cli.main import main

boto3 = pytest.importorskip("boto3", reason="the object store is not installed")
s3fs = pytest.importorskip("s3fs", reason="the object store is not installed")
BAG = Path(__file__).parents[2] / "recordings" / "golden" / "run" / "bag"
URL = "s3://shelf/run"
BLOCK = 64 << 10
REPORT = re.compile(r"^(s3://\S+): (\d+) requests, (\d+) of (\d+) bytes read$", re.MULTILINE)


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], str]]:
    """Start a store that holds the bag; return a function that gives its record of requests."""
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "key")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    monkeypatch.setattr(stored_file, "BLOCK", BLOCK)
    monkeypatch.setattr(stored_file, "_opened", {})
    path = tmp_path / "store.log"
    command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", "0"]
    with path.open("w") as output, subprocess.Popen(command, stderr=output, text=True) as store:
        try:
            while not (found := re.search(r"http://127\.0\.0\.1:[1-9]\d*", path.read_text())):
                assert store.poll() is None, path.read_text()
            monkeypatch.setenv("AWS_ENDPOINT_URL", found[0])
            client = boto3.client("s3")
            client.create_bucket(Bucket="shelf")
            for file in BAG.iterdir():
                client.upload_file(str(file), "shelf", f"run/{file.name}")
            yield path.read_text
        finally:
            store.kill()
            s3fs.S3FileSystem.clear_instance_cache()  # which knows this store's address


def run(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[str, str]:
    assert main([str(word) for word in words]) == 0
    out, err = capsys.readouterr()
    return out, err


def test_info_and_train_give_the_same_from_a_store_with_as_few_requests_as_they_say(
    log: Callable[[], str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    local, _ = run(capsys, "bag", "info", BAG)
    remote, said = run(capsys, "bag", "info", URL)
    size = (BAG / "bag_0.mcap").stat().st_size
    (file, requests, read, whole), *others = REPORT.findall(said)
    assert (file, int(whole), others) == (f"{URL}/bag_0.mcap", size, [])
    assert int(read) <= size
    assert int(requests) <= size // BLOCK + 1
    assert remote.replace(URL, str(BAG)) == local

    # the same name, so that nothing but where it is stored differs
    (tmp_path / "run").symlink_to(BAG)
    run(capsys, "train", tmp_path / "run", "--out", tmp_path / "local.npz")
    _, said = run(capsys, "train", URL, "--out", tmp_path / "remote.npz")
    assert (tmp_path / "remote.npz").read_bytes() == (tmp_path / "local.npz").read_bytes()
    ((_, requests, read, _),) = REPORT.findall(said)
    assert int(read) == size  # all of it, for its hash, but nothing twice
    asked = re.findall(r"GET /shelf/run/bag_0\.mcap .* 206", log())
    assert len(asked) == int(requests)


def test_a_brief_info_reads_the_index_only(
    log: Callable[[], str], capsys: pytest.CaptureFixture[str]
) -> None:
    brief, said = run(capsys, "bag", "info", URL, "--brief")
    ((_, requests, read, whole),) = REPORT.findall(said)
    assert int(requests) <= 3
    assert int(read) <= 3 * BLOCK < int(whole)
    counts = re.compile(r"^/\S+ +\d+|^messages.*|^time.*", re.MULTILINE)
    full, _ = run(capsys, "bag", "info", URL)
    assert len(counts.findall(brief)) > 10
    assert counts.findall(brief) == counts.findall(full)
    assert "not read" in brief
    assert "not read" not in full
    as_json, _ = run(capsys, "bag", "info", URL, "--brief", "--json")
    assert json.loads(as_json)["index_only"] is True


def test_what_a_store_has_against_it_is_said_in_one_line(
    log: Callable[[], str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    nothing, strange = "there is no bag", "Unsupported filesystem"
    for place, reason in {
        "s3://shelf/other": nothing, "s3://nowhere/run": nothing, "odd://shelf/run": strange,
    }.items():  # fmt: skip
        assert main(["bag", "info", place]) == 2
        error = capsys.readouterr().err
        assert error.startswith("koop bag info: error: ")
        assert place in error
        assert reason in error
        assert error.count("\n") == 1
    monkeypatch.setitem(sys.modules, "upath", None)
    assert main(["bag", "info", URL]) == 2
    assert "pip install universal-pathlib fsspec" in capsys.readouterr().err
