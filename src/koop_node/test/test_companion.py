"""A program of others beside the nodes ends as they do, with all that it started."""

import os
import signal
import subprocess
import sys

import pytest

from koop_node.process.lifeline import TIED

COMPANION = [sys.executable, "-m", "koop_node.process.companion"]
# A shell that starts a program and waits for it; both hold the pipe of their stdout open.
WITH_A_CHILD = ["sh", "-c", "sleep 600 & echo started; wait; echo never"]


def start(*words, **options):
    return subprocess.Popen(
        [*COMPANION, *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, **options
    )


@pytest.mark.parametrize("code", [0, 3])
def test_it_ends_with_the_exit_code_of_the_program(code):
    with start("sh", "-c", f"exit {code}") as process:
        assert process.wait(60.0) == code


def test_a_program_that_is_killed_is_a_failure():
    with start("sh", "-c", "kill -KILL $$") as process:
        assert process.wait(60.0) == 128 + signal.SIGKILL


def test_there_is_no_such_program():
    done = subprocess.run([*COMPANION, "/nowhere/rig"], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (2, "error: /nowhere/rig: No such file or directory\n")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_who_is_asked_to_end_ends_with_its_children_which_is_no_failure(number):
    with start(*WITH_A_CHILD) as process:
        assert process.stdout.readline() == "started\n"
        process.send_signal(number)
        # the pipe has an end when nobody is left who could write to it
        assert process.stdout.read() == ""
        assert process.wait(60.0) == 0


def test_it_ends_with_whoever_started_it():
    with start(*WITH_A_CHILD, env={**os.environ, **TIED}) as process:
        assert process.stdout.readline() == "started\n"
        process.stdin.close()
        assert process.stdout.read() == ""
        assert process.wait(60.0) == 0


def test_a_program_that_knows_the_lifeline_does_not_take_its_own_stdin_for_one():
    code = (
        "from koop_node.process.lifeline import *; import time; end_with_parent(); time.sleep(0.3)"
    )
    with start(sys.executable, "-c", code, env={**os.environ, **TIED}) as process:
        assert process.wait(60.0) == 0
