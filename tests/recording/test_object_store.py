"""Bags in an object store: the same answers as from the disk, no byte asked for twice."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from fsspec.implementations.cached import CachingFileSystem

from koop_bag.mcap import stored_file
from koop_lab.cli.main import main

boto3 = pytest.importorskip("boto3", reason="the object store is not installed")
s3fs = pytest.importorskip("s3fs", reason="the object store is not installed")
BAG = Path(__file__).parents[2] / "recordings" / "golden" / "run" / "bag"
URL = "s3://shelf/run"


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], str]]:
    """Start a store that holds the bag; return a function that gives its record of requests."""
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "key")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    path = tmp_path / "store.log"
    command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", "0"]
    with path.open("w") as output, subprocess.Popen(command, stderr=output, text=True) as store:
        try:
            while not (actual := re.search(r"http://127\.0\.0\.1:[1-9]\d*", path.read_text())):
                assert store.poll() is None, path.read_text()
            monkeypatch.setenv("AWS_ENDPOINT_URL", actual[0])
            client = boto3.client("s3")
            client.create_bucket(Bucket="shelf")
            for file in BAG.iterdir():
                client.upload_file(str(file), "shelf", f"run/{file.name}")
            yield path.read_text
        finally:
            store.kill()
            stored_file._with_cache.cache_clear()
            for kind in (s3fs.S3FileSystem, CachingFileSystem):  # which know this store's address
                kind.clear_instance_cache()


def run(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    assert main([str(word) for word in words]) == 0
    return str(capsys.readouterr().out)


def requests(log: str) -> int:
    """Return how often a part of the bag's file was read."""
    return len(re.findall(r"GET /shelf/run/bag_0\.mcap .* 206", log))


def test_info_and_train_give_the_same_from_a_store_that_is_asked_for_each_block_once(
    log: Callable[[], str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    local = run(capsys, "bag", "info", BAG)
    remote = run(capsys, "bag", "info", URL)
    assert remote.replace(URL, str(BAG)) == local
    # the same name, so that nothing but where it is stored differs
    (tmp_path / "run").symlink_to(BAG)
    run(capsys, "train", tmp_path / "run", "--out", tmp_path / "local.npz")
    run(capsys, "train", URL, "--out", tmp_path / "remote.npz")
    assert (tmp_path / "remote.npz").read_bytes() == (tmp_path / "local.npz").read_bytes()
    assert requests(log()) == 1  # the file is smaller than a block


def test_an_error_of_a_store_is_one_line(
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
