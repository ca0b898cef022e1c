"""A loop answers at the name that holds its place; only its user may stop it."""

import os
import socket
import subprocess
import sys
import threading
from contextlib import ExitStack

import pytest

from koop_core.errors import LiveError
from koop_node.client.alone import PREFIX, claimed
from koop_node.client.desk import MOST, STATUS, STOP, Desk, ask, find_loops

ANSWER = {"healthy": True, "text": "all is well", "places": []}
STRANGER = """
import os, socket, sys
os.setgid(65534)
os.setuid(65534)  # nobody
with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as loop:
    loop.connect(chr(0) + sys.argv[1])
    for question in sys.argv[2:]:
        loop.send(question.encode())
    print(loop.recv(65536).decode())
"""


@pytest.fixture
def name():
    return f"{PREFIX}99/test{os.getpid()}"


class Loop(threading.Thread):
    """Answers until it is asked to stop."""

    def __init__(self, place):
        super().__init__()
        self.desk, self.over = Desk(place), threading.Event()
        self.stopped = False

    def run(self):
        while not (self.over.is_set() or self.stopped):
            self.stopped = self.desk.answer(lambda: ANSWER)
        self.desk.close("theta is left at 1")


@pytest.fixture
def loop(name):
    with claimed(name) as (first, place):
        assert first
        loop = Loop(place)
        loop.start()
        yield loop
        loop.over.set()
        loop.join()


def test_a_loop_says_how_it_is_until_it_is_stopped(name, loop):
    assert name in find_loops()
    for _ in range(40):  # more than are answered at a time
        answer = ask(name, STATUS)
        assert {key: answer[key] for key in ANSWER} == ANSWER
    assert (answer["pid"], answer["user"]) == (os.getpid(), os.geteuid())
    assert "refused" in ask(name, "dance")
    assert not loop.stopped
    assert ask(name, STOP)["text"] == "theta is left at 1"
    assert loop.stopped


def test_who_asks_nothing_keeps_nobody_waiting(name, loop):
    with ExitStack() as stack:
        for _ in range(3 * MOST):
            silent = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            stack.enter_context(silent).connect(f"\0{name}")
        assert ask(name, STATUS)["healthy"]
        assert len(loop.desk._asking) <= 2 * MOST  # while it answers
        assert ask(name, STOP)["text"] == "theta is left at 1"


def test_a_question_waits_while_the_queue_of_a_loop_is_full(name):
    with claimed(name) as (_, place), ExitStack() as stack:
        desk, over = Desk(place), threading.Event()
        for _ in range(MOST + 1):  # one more than the backlog
            silent = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            stack.enter_context(silent).connect(f"\0{name}")

        def answer():
            while not over.wait(0.2):  # as a loop that does something else, too
                desk.answer(lambda: ANSWER)

        thread = threading.Thread(target=answer)
        thread.start()
        try:
            assert ask(name, STATUS)["healthy"]
        finally:
            over.set()
            thread.join()


@pytest.mark.parametrize("words", ["no JSON", "[1]", "{}", '{"healthy": true, "text": "x"}'])
def test_a_program_that_answers_as_no_loop_does_is_told(name, words):
    """Failed before: the command ended with a traceback, for all loops of the machine."""
    with claimed(name) as (_, place):
        place.listen()

        def answer():
            asking, _ = place.accept()
            with asking:
                asking.recv(64)
                asking.send(words.encode())

        thread = threading.Thread(target=answer)
        thread.start()
        with pytest.raises(LiveError, match=f"{os.getpid()}: its answer is not one of a loop"):
            ask(name, STATUS)
        thread.join()


def test_a_name_that_no_loop_has_is_left_out():
    """Failed before: the command ended with a traceback, for all loops of the machine."""
    foreign = f"{PREFIX}test{os.getpid()}"
    with claimed(foreign) as (first, place):
        assert first
        place.listen()
        assert foreign not in find_loops()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root is also another user")
def test_another_user_may_look_but_not_stop(name, loop):
    def asked(question):
        words = [sys.executable, "-S", "-c", STRANGER, name, question]
        return subprocess.run(words, capture_output=True, text=True, check=True).stdout

    assert "all is well" in asked(STATUS)
    assert "refused" in asked(STOP)
    assert not loop.stopped


def test_a_loop_that_hangs_or_ends_without_a_word_is_told(name):
    with claimed(name) as (_, place):
        with pytest.raises(LiveError, match="does not answer: it is starting"):
            ask(name, STATUS)
        place.listen()
        with pytest.raises(LiveError, match=f"process {os.getpid()}: hangs"):
            ask(name, STATUS, 0.05)
    with pytest.raises(LiveError, match="does not answer"):
        ask(name, STATUS)
    assert name not in find_loops()
