"""What is collected when, and which pages of the compiler may go."""

import gc
import subprocess
import sys
import weakref

import pytest

from koop_node.process.housekeeping import LONGEST, PERIOD, ROOM, Housekeeping, clean_mappings

MAPS = """\
7f0000000000-7f0000001000 r--p 00000000 08:01 1    /lib/libllvmlite.so
Size:                  4 kB
Private_Clean:         4 kB
Private_Dirty:         0 kB
Anonymous:             0 kB
VmFlags: rd mr
7f0000001000-7f0000003000 r-xp 00001000 08:01 1    /lib/libllvmlite.so
Shared_Dirty:          0 kB
Private_Dirty:         0 kB
Anonymous:             0 kB
7f0000003000-7f0000004000 r--p 00003000 08:01 1    /lib/libllvmlite.so
Private_Dirty:         4 kB
Anonymous:             4 kB
7f0000004000-7f0000005000 rw-p 00004000 08:01 1    /lib/libllvmlite.so
Private_Dirty:         0 kB
Anonymous:             0 kB
7f0000005000-7f0000006000 r-xp 00000000 08:01 2    /lib/libc.so.6
Private_Dirty:         0 kB
Anonymous:             0 kB
7f0000006000-7f0000007000 r--p 00000000 00:00 0
Private_Dirty:         0 kB
Anonymous:             0 kB
"""


class Knot:
    """Refers to itself: only a collection ends it."""

    def __init__(self):
        self.me = self


@pytest.fixture
def house():
    made = Housekeeping(now=0.0)
    yield made
    made.end()


def test_garbage_is_collected_between_ticks_and_only_there(house):
    knot = weakref.ref(Knot())
    house.tidy(PERIOD / 2, room=1.0)
    assert knot() is not None  # it is not time yet
    house.tidy(PERIOD, room=ROOM / 2)
    assert knot() is not None  # a timer is due soon
    house.tidy(PERIOD, room=ROOM)
    assert knot() is None


def test_garbage_is_collected_at_last_where_there_is_never_time(house):
    knot = weakref.ref(Knot())
    house.tidy(PERIOD + LONGEST, room=0.0)
    assert knot() is None


def test_what_was_there_at_the_start_is_not_looked_through():
    before = Knot()
    observed = weakref.ref(before)
    house = Housekeeping(now=0.0)
    del before
    try:
        house.tidy(PERIOD, room=1.0)
        assert observed() is not None
    finally:
        house.end()
    assert gc.isenabled()
    gc.collect()
    assert observed() is None


NODE = """
import gc
from koop_node.node.main import run
from koop_node.node.managed import ManagedNode, Run

class Work(Run):
    def __init__(self, node, entities):
        self.node = node

    def activate(self, entities):
        entities.timer(0.001, self.look)

    def look(self):
        print(any(item is self for item in gc.get_objects()))
        self.node.finish()

class Worker(ManagedNode):
    def __init__(self):
        super().__init__("worker", Work)

run(Worker)
"""


@pytest.mark.ros
def test_what_nodes_have_made_once_they_are_active_is_not_looked_through():
    """Numba and the kernels: 50 000 objects, which took 25 ms of every second of a loop."""
    done = subprocess.run([sys.executable, "-c", NODE], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


def test_only_mappings_that_are_as_their_file_are_let_go():
    """Relocated pages, though read-only, are nowhere but in memory."""
    actual = list(clean_mappings(MAPS, "libllvmlite"))
    assert actual == [(0x7F0000000000, 0x7F0000001000), (0x7F0000001000, 0x7F0000003000)]
