"""A guest in a ROS domain."""

import os
import signal

import pytest

from koop_node.client import Client

pytestmark = pytest.mark.ros


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_within_a_callback_comes_after_it_and_without_a_trace(number, capfd):
    before = signal.signal(number, signal.default_int_handler)
    done = []

    def callback():
        os.kill(os.getpid(), number)
        done.append(number)

    try:
        with Client("guest") as client:
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
        with Client("guest") as client:
            os.kill(os.getpid(), signal.SIGHUP)
            client.spin(0.0)
            signal.signal(signal.SIGHUP, lambda number, frame: came.append(number))
        os.kill(os.getpid(), signal.SIGHUP)
        assert came == [signal.SIGHUP]
    finally:
        signal.signal(signal.SIGHUP, before)
