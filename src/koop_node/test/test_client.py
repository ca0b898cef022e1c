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
            assert signal.getsignal(number) is signal.default_int_handler
    finally:
        signal.signal(number, before)
    assert done
    assert capfd.readouterr().err == ""
