"""What a process asks the system for, done in a process of its own."""

import json
import os
import subprocess
import sys

CHILD = """
import json, os, sys, threading
from koop_node.process.realtime import apply_priority
exec(sys.argv[2])
end = threading.Event()
threading.Thread(target=end.wait).start()
problems = apply_priority(int(sys.argv[1]))
threads = list(map(int, os.listdir("/proc/self/task")))
locked = [r for r in open("/proc/self/status") if r.startswith("VmLck")][0].split()[1]
print(json.dumps({
    "problems": problems, "locked": int(locked),
    "policies": [[os.sched_getscheduler(t), os.sched_getparam(t).sched_priority] for t in threads],
}))
end.set()
"""


def applied(priority, before=""):
    """Apply a priority in a process that `before` has taken rights from."""
    done = subprocess.run(
        [sys.executable, "-c", CHILD, str(priority), before],
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


def test_what_is_not_permitted_names_the_right_and_is_done_without():
    actual = applied(70, WITHOUT_RIGHTS)
    priority, memory = actual["problems"]
    assert "priority = 70" in priority
    assert "CAP_SYS_NICE" in priority
    assert "rtprio 70" in priority
    assert "locked memory" in memory
    assert "CAP_IPC_LOCK" in memory
    assert {policy for policy, _ in actual["policies"]} == {os.SCHED_OTHER}


def test_all_threads_have_the_priority_and_memory_is_locked_where_permitted():
    actual = applied(3)
    permitted = "\n".join(actual["problems"])
    if "priority" not in permitted:
        assert actual["policies"] == [[os.SCHED_FIFO, 3], [os.SCHED_FIFO, 3]]
    if "locked memory" not in permitted:
        assert actual["locked"] > 0


def test_nothing_is_asked_for_by_default():
    assert applied(0)["problems"] == []
