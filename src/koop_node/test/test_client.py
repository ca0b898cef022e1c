"""A client in a ROS domain."""

import ctypes
import os
import signal
import threading
import time
from contextlib import contextmanager, suppress

import pytest
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import TransitionCallbackReturn

from koop_core.errors import LiveError
from koop_node.client.client import Client
from koop_node.node.rclpy_internals import RefusingLifecycleNode

pytestmark = pytest.mark.ros


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_within_a_callback_comes_after_it_and_without_a_trace(number, capfd):
    # of a damaged message of an earlier test, which the next error would print
    ctypes.CDLL("librcutils.so").rcutils_reset_error()
    before = signal.signal(number, signal.default_int_handler)
    done = []

    def callback():
        os.kill(os.getpid(), number)
        done.append(number)

    try:
        with Client("client") as client:
            client.node.create_timer(0.01, callback)
            with pytest.raises(KeyboardInterrupt):
                client.wait_for(lambda: False, 10.0, "Ctrl-C")
            with pytest.raises(KeyboardInterrupt):  # between two callbacks there is no waiting
                os.kill(os.getpid(), number)
        assert signal.getsignal(number) is signal.default_int_handler
    finally:
        signal.signal(number, before)
    assert done
    assert capfd.readouterr().err == ""


def test_a_signal_that_was_ignored_stays_so_and_a_later_handler_is_kept():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    came = []
    try:
        with Client("client") as client:
            os.kill(os.getpid(), signal.SIGHUP)
            client.spin(0.0)
            signal.signal(signal.SIGHUP, lambda number, frame: came.append(number))
        os.kill(os.getpid(), signal.SIGHUP)
        assert came == [signal.SIGHUP]
    finally:
        signal.signal(signal.SIGHUP, before)


class Slow(RefusingLifecycleNode):
    """Takes longer to be configured than a client waits for an answer."""

    def on_configure(self, state):
        time.sleep(2.5)
        return TransitionCallbackReturn.SUCCESS


@contextmanager
def spinning(kind, name):
    context = rclpy.Context()
    context.init(args=[])
    executor = SingleThreadedExecutor(context=context)
    node = kind(name, context=context)
    executor.add_node(node)

    def spin():
        with suppress(ExternalShutdownException):
            executor.spin()

    thread = threading.Thread(target=spin)
    thread.start()
    try:
        yield
    finally:
        context.shutdown()
        thread.join()
        node.destroy_node()


def test_a_transition_that_takes_long_is_asked_for_once_and_an_impossible_one_is_told(capfd):
    with spinning(Slow, "slow"), Client("client") as client:
        client.change_state("/slow", "configure", 60.0)
        client.change_state("/slow", "activate")
        assert capfd.readouterr().err == ""  # where a second request would be refused
        with pytest.raises(LiveError, match="active and cannot configure"):
            client.change_state("/slow", "configure")
        # what came after Jazzy says it itself
        refused = {"jazzy": "refused:"}.get(os.environ["ROS_DISTRO"], "Unable to start")
        assert f"{refused} transition 1" in capfd.readouterr().err
