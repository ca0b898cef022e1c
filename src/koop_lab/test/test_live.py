"""Node processes: started, watched, and none left behind."""

import signal
import sys

import pytest

from koop_lab.live.loop import NodeProcess

# Ends when it is told to, and until then lets its parent be told once more.
ENDS_LATE = """
import os, signal, sys
def on_signal(number, frame):
    os.kill(os.getppid(), signal.SIGINT)
    print("ended", flush=True)
    sys.exit(0)
signal.signal(signal.SIGINT, on_signal)
print("started", flush=True)
while True:
    signal.pause()
"""


def test_ctrl_c_that_comes_again_does_not_keep_a_node_from_being_stopped(tmp_path):
    log = tmp_path / "node.log"
    node = NodeProcess("node", [ENDS_LATE], log, [sys.executable, "-c"])
    while "started" not in log.read_text():
        assert node.poll() is None
    handler = signal.getsignal(signal.SIGINT)
    try:
        assert node.stop() == 0
    except KeyboardInterrupt:
        node.process.kill()
        pytest.fail("the second Ctrl-C ended the stopping, not the node")
    assert "ended" in log.read_text()
    assert signal.getsignal(signal.SIGINT) is handler
