"""Processes that work one after the other."""

import os
import subprocess
import sys

from koop_bringup.live.turns import take_turns

# A thread that is there already, as those of DDS are.
TWO_THREADS = """
import threading
threading.Thread(target=threading.Event().wait, daemon=True).start()
print(flush=True)
input()
"""


def test_those_who_take_turns_share_a_processor_and_their_listener_has_all():
    command = [sys.executable, "-c", TWO_THREADS]
    pipe = subprocess.PIPE
    processes = [subprocess.Popen(command, stdin=pipe, stdout=pipe) for _ in range(3)]
    try:
        for process in processes:
            process.stdout.readline()
        gone = subprocess.Popen(["true"])
        gone.wait()
        take_turns([gone.pid, processes[0].pid, processes[1].pid], [processes[2].pid])
        by_process = [_threads(process.pid) for process in processes]
    finally:
        for process in processes:
            process.communicate(b"\n")
    allowed = os.sched_getaffinity(0)
    policy = os.SCHED_BATCH if len(allowed) > 1 else os.SCHED_OTHER
    assert [len(threads) for threads in by_process] == [2, 2, 2]
    assert {actual for threads in by_process for _, actual in threads} == {policy}
    (shared,) = {frozenset(cpus) for threads in by_process[:2] for cpus, _ in threads}
    assert len(shared) == 1
    assert all(cpus == allowed for cpus, _ in by_process[2])


def _threads(pid):
    threads = map(int, os.listdir(f"/proc/{pid}/task"))
    return [(os.sched_getaffinity(t), os.sched_getscheduler(t)) for t in threads]
