"""Our bags, decoded whole by the reference reader in TypeScript, with its checks on."""

import json
import re
import shutil
import subprocess
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from koop_bag_messages import LOOP
from koop_bag_ros import Recorder, Talker, publish
from rosbags.highlevel import AnyReader

from koop_bag.bag.writer import BagWriter

HERE = Path(__file__).parent / "mcap_core"
NO_NETWORK = re.compile("ENOTFOUND|EAI_AGAIN|ECONNREFUSED|ECONNRESET|ETIMEDOUT|ENETUNREACH")


@pytest.fixture(scope="session")
def decode(tmp_path_factory):
    """Return a function that runs the reader on a file."""
    if not (shutil.which("node") and shutil.which("npm")):
        pytest.skip("@mcap/core needs Node.js and npm, which are not installed")
    folder = tmp_path_factory.mktemp("mcap_core")
    for name in ("package.json", "decode.mjs"):
        shutil.copy(HERE / name, folder)
    install = ["npm", "install", "--no-audit", "--no-fund", "--no-package-lock", "--ignore-scripts"]
    done = subprocess.run(install, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode and NO_NETWORK.search(done.stderr):
        pytest.skip("npm could not install @mcap/core: there is no network")
    assert done.returncode == 0, done.stderr

    def run(path):
        command = ["node", "decode.mjs", str(path)]
        return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)

    return run


def messages_of(done):
    assert done.returncode == 0, done.stderr
    *messages, end = map(json.loads, done.stdout.splitlines())
    assert end == {"profile": "ros2", "messages": len(messages)}
    return messages


def simple(value):
    """Return a message of `rosbags` as the other reader prints it."""
    if isinstance(value, np.ndarray):
        return [simple(item) for item in value.tolist()]
    if isinstance(value, list):
        return [simple(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return {"nan": "NaN", "inf": "Infinity", "-inf": "-Infinity"}[str(value)]
    return value


def assert_same(actual, expected):
    """Every field of a message is what `rosbags` says."""
    for name, value in actual.items():
        # the one package calls the parts of a stamp sec and nsec, the other sec and nanosec
        other = getattr(expected, "nanosec" if name == "nsec" else name)
        if isinstance(value, dict):
            assert_same(value, other)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            for item, item_expected in zip(value, other, strict=True):
                assert_same(item, item_expected)
        elif isinstance(value, str) and isinstance(other, int):
            assert int(value) == other  # 64 bits do not fit into a number of JavaScript
        elif isinstance(value, int) and isinstance(other, float):
            assert float(value) == other, name  # which writes 1e17 without a point
        else:
            assert value == simple(other), name


def check(decode, folder):
    """Compare all messages of a bag of one file with what `rosbags` says."""
    (path,) = folder.glob("*.mcap")
    actual = messages_of(decode(path))
    by_topic = {}
    for item in actual:
        by_topic.setdefault(item["topic"], []).append(item)
    with AnyReader([folder]) as reader:
        assert len(actual) == reader.message_count
        for connection in reader.connections:
            messages = reader.messages([connection])
            both = zip(by_topic.get(connection.topic, []), messages, strict=True)
            for item, (_, time, raw) in both:
                assert int(item["logTime"]) == time
                assert_same(item["decoded"], reader.deserialize(raw, connection.msgtype))
    return actual


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_every_message_is_decoded_with_checksums_on(decode, write_loop, compression):
    actual = check(decode, write_loop(n=500, compression=compression))
    assert Counter(item["topic"] for item in actual) == dict.fromkeys(LOOP, 500)
    sequences = [item["sequence"] for item in actual if item["topic"] == "/state"]
    assert sequences == list(range(1, 501))


@pytest.mark.ros
def test_a_bag_that_the_recorder_made_is_decoded(decode, tmp_path, messages):
    with Recorder(tmp_path / "run") as recorder, Talker() as talker:
        publish(talker.publishers(LOOP), messages.loop, range(300))
        for topic in LOOP:
            recorder.wait_for(topic, 300)
        recorder.stop()
    actual = check(decode, tmp_path / "run" / "bag")
    assert {item["topic"] for item in actual} >= set(LOOP)


def test_an_empty_bag_is_a_bag(decode, tmp_path):
    BagWriter(tmp_path / "bag").close()
    assert messages_of(decode(tmp_path / "bag" / "bag_0.mcap")) == []


def test_the_checks_are_on_a_wrong_byte_is_noticed(decode, write_loop):
    path = write_loop(n=300, compression="none") / "run_0.mcap"
    data = bytearray(path.read_bytes())
    at = data.index((77).to_bytes(8, "little"), 20_000)  # inside of a message
    data[at] ^= 1
    path.write_bytes(data)
    done = decode(path)
    assert done.returncode != 0
    assert "CRC" in done.stderr
