"""What a process asks the system for, done in a process of its own."""

import json
import os
import subprocess
import sys

import pytest

from koop_core.config.parameter import ConfigError, NodeConfig
from koop_node.process.realtime import requested

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="Linux only")
CHILD = """
import json, os, sys, threading
from koop_core.config.parameter import NodeConfig
from koop_node.process.realtime import apply
exec(sys.argv[2])
end = threading.Event()
threading.Thread(target=end.wait).start()
problems = apply(NodeConfig(**json.loads(sys.argv[1])))
threads = list(map(int, os.listdir("/proc/self/task")))
locked = [r for r in open("/proc/self/status") if r.startswith("VmLck")][0].split()[1]
print(json.dumps({
    "problems": problems, "locked": int(locked),
    "policies": [[os.sched_getscheduler(t), os.sched_getparam(t).sched_priority] for t in threads],
    "cpus": [sorted(os.sched_getaffinity(t)) for t in threads],
}))
end.set()
"""


def applied(before="", **asked):
    """Apply what is asked for in a process that `before` has taken rights from."""
    done = subprocess.run(
        [sys.executable, "-c", CHILD, json.dumps(asked), before],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    return json.loads(done.stdout)


# drop all rights of root and every limit that would stand in for them
WITHOUT_RIGHTS = """
import os, resource
resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))
if os.getuid() == 0:
    os.setgroups([]); os.setgid(65534); os.setuid(65534)
"""


@LINUX
def test_all_threads_keep_to_the_processors():
    one = min(os.sched_getaffinity(0))
    found = applied(cpus=str(one))
    assert found["problems"] == []
    assert found["cpus"] == [[one], [one]]


@LINUX
def test_what_is_not_permitted_names_the_right_and_is_done_without():
    found = applied(WITHOUT_RIGHTS, priority=70, lock_memory=True)
    priority, memory = found["problems"]
    assert "priority = 70" in priority
    assert "CAP_SYS_NICE" in priority
    assert "rtprio 70" in priority
    assert "lock_memory" in memory
    assert "CAP_IPC_LOCK" in memory
    assert {policy for policy, _ in found["policies"]} == {os.SCHED_OTHER}


@LINUX
def test_a_processor_that_is_not_there_is_said():
    (problem,) = applied(cpus="4000")["problems"]
    assert "cpus = 4000" in problem
    assert "going on without" in problem


@LINUX
def test_all_threads_have_the_priority_and_memory_is_locked_where_permitted():
    found = applied(priority=3, lock_memory=True)
    permitted = "\n".join(found["problems"])
    if "priority" not in permitted:
        assert found["policies"] == [[os.SCHED_FIFO, 3], [os.SCHED_FIFO, 3]]
    if "lock_memory" not in permitted:
        assert found["locked"] > 0


@LINUX
def test_nothing_is_asked_for_by_default():
    assert applied()["problems"] == []


@pytest.mark.parametrize("text", ["x", "1-", "2-1", "-1", "1,,2", "1 2", "9" * 30])
def test_a_list_that_is_none_is_refused(text):
    with pytest.raises(ConfigError, match="must be a list"):
        NodeConfig(cpus=text)


def test_the_nodes_of_a_process_ask_together():
    given = [NodeConfig(priority=5), NodeConfig(cpus="1", lock_memory=True), NodeConfig(priority=9)]
    assert requested(given) == NodeConfig(priority=9, cpus="1", lock_memory=True)
    with pytest.raises(ConfigError, match="0 and 1"):
        requested([NodeConfig(cpus="0"), NodeConfig(cpus="1")])
