"""How a process of nodes ends."""

import subprocess
import sys

import pytest

FAULTY = """
import sys

from koop_node.node import schedule
from koop_node.node.main import run
from koop_node.node.managed import ManagedNode, Run

class FaultyRun(Run):
    def __init__(self, node, entities):
        pass

    def activate(self, entities):
        entities.timer(0.01, lambda: 1 / 0)

    def deactivate(self):
        print("deactivated, asked to end by", schedule.current().asked, flush=True)

class FaultyNode(ManagedNode):
    def __init__(self):
        super().__init__("faulty", FaultyRun)

sys.exit(run(FaultyNode))
"""


@pytest.mark.ros
def test_a_node_with_a_fault_is_deactivated_before_its_process_ends():
    """Failed before: a guard whose twin was lost left theta to nobody."""
    done = subprocess.run(
        [sys.executable, "-c", FAULTY], capture_output=True, text=True, timeout=240
    )
    assert done.stdout == "deactivated, asked to end by 15\n"  # as after SIGTERM: it failed
    assert "ZeroDivisionError" in done.stderr
    assert done.returncode == 1
