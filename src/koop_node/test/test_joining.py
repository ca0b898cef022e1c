"""A node joins its ROS domain also where a killed process has left a mailbox unfilled."""

import itertools
import os
import re
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from koop_node.client.client import Client
from koop_node.process import joining
from koop_node.process.domain import FIRST_PORT, PORTS, hold_domain
from koop_node.process.joining import FAST_DDS, FOLDER, LOCKED, remove_dead, remove_unfilled

JOIN = """
import sys
from koop_node.client.client import Client
from koop_node.process import joining
joining.FILLING = 0.2
if sys.argv[2:]:  # the mailbox is left only after this process has looked
    joining.remove_unfilled, joining.JOINING = lambda: None, 1.0
with Client("late", int(sys.argv[1]), udp=False):
    print("joined")
"""
LEAVE = """
import ctypes
from rclpy.node import Node
from koop_node.client.client import Client
from koop_node.process import joining
joining.LEAVING = 0.2
Node.destroy_node = lambda node: ctypes.PyDLL(None).sleep(60)  # with Python's lock
with Client("stuck", udp=False):
    print("joined", flush=True)
"""
LIVE = [
    sys.executable,
    "-c",
    """
from koop_node.client.client import Client
client = Client("other", udp=False)
print("joined", flush=True)
client.spin_until(lambda: False, 60.0)
""",
]
SIZE = 52400  # [bytes] of a mailbox
UNFILLED = {"made": b"", "sized": bytes(SIZE), "begun": bytes([1]) + bytes(SIZE - 1)}
TRIES = 5
LONG = 60.0  # [s] for a process to start on a busy machine


def mailbox(domain):
    """Return the mailbox of a domain's first participant (DDSI-RTPS 9.6.1)."""
    return FOLDER / f"{FAST_DDS}_port{FIRST_PORT + PORTS * domain + 11}"


def sent_by(pid):
    """Return the files that hold what a process has sent."""
    links = {os.readlink(item) for item in Path(f"/proc/{pid}/fd").iterdir() if item.is_symlink()}
    found = [re.fullmatch(rf"(/dev/shm/{FAST_DDS}_[0-9a-f]{{16}})_el", link) for link in links]
    return [Path(match[1]) for match in found if match]


@contextmanager
def left(content):
    """A mailbox that was left with a content, in a domain that nobody takes part in."""
    with hold_domain() as domain:
        path = mailbox(domain)
        path.write_bytes(content)
        try:
            yield domain, path
        finally:
            with suppress(FileNotFoundError):
                path.unlink()


def join(*words):
    command = [sys.executable, "-c", JOIN, *map(str, words)]
    return subprocess.run(command, stdout=subprocess.PIPE, timeout=LONG)


@pytest.mark.ros
@pytest.mark.parametrize("content", UNFILLED.values(), ids=UNFILLED)
def test_what_a_killed_process_left_unfilled_does_not_stop_others(content):
    with left(content) as (domain, path):
        assert join(domain).stdout == b"joined\n"
        assert path not in joining._unfilled()


@pytest.mark.ros
def test_who_hangs_on_a_mailbox_ends_although_python_is_locked():
    for _ in range(TRIES):
        with left(bytes(SIZE)) as (domain, path):
            done = join(domain, "blind")
            if path.exists():
                break  # else another process has removed it, as it should
    assert (done.returncode, done.stdout) == (-signal.SIGALRM, b"")


@pytest.mark.ros
def test_who_hangs_as_it_leaves_ends_although_python_is_locked():
    done = subprocess.run([sys.executable, "-c", LEAVE], stdout=subprocess.PIPE, timeout=LONG)
    assert (done.returncode, done.stdout) == (-signal.SIGALRM, b"joined\n")


@pytest.mark.ros
def test_what_a_killed_process_had_sent_is_removed_and_what_a_living_one_has_is_not(own_domain):
    with Client("living", udp=False), subprocess.Popen(LIVE, stdout=subprocess.PIPE) as killed:
        assert killed.stdout.readline() == b"joined\n"
        segments = {pid: sent_by(pid) for pid in (os.getpid(), killed.pid)}
        killed.kill()
        killed.wait()
        for segment in itertools.chain(*segments.values()):
            past = time.time() - LOCKED - 1.0
            os.utime(f"{segment}_el", (past, past))
        remove_dead()
        there = [[s for s in found if s.exists()] for found in segments.values()]
        assert there == [segments[os.getpid()], []]
        assert all(segments.values())


def test_a_mailbox_that_is_filled_meanwhile_stays(tmp_path, monkeypatch):
    monkeypatch.setattr(joining, "FOLDER", tmp_path)
    monkeypatch.setattr(joining, "FILLING", 1.0)
    slow, dead, lock = (tmp_path / f"{FAST_DDS}_port{end}" for end in ("7411", "7413", "7411_el"))
    for path in (slow, dead, lock):
        path.write_bytes(b"")
    looked = threading.Event()

    def fill():
        looked.wait()
        slow.write_bytes(b"\2\0\0\0")

    look = joining._unfilled

    def unfilled():
        found = look()
        looked.set()
        return found

    monkeypatch.setattr(joining, "_unfilled", unfilled)
    thread = threading.Thread(target=fill)
    thread.start()
    remove_unfilled()
    thread.join()
    assert sorted(tmp_path.iterdir()) == sorted([slow, lock])
