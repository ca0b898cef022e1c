"""The compiled stages of the nodes of a process: one node's, or those of a loop in lockstep.

What a node does with a message that follows on the last one is the same for ever: it takes it, runs
its kernel, publishes the answer, waits. That is compiled, with rcl's own functions; every message
goes through DDS as ever. What is not plain (another layout, a gap, a join, the last step) goes to
the node, in Python, before anything is done with it; so does all else that happens: timers,
services, signals.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from koop_core.port import FAILED, IDLE
from koop_core.wakeup import alone
from koop_node.node.executor import Executor
from koop_node.node.managed import ManagedNode
from koop_node.process.housekeeping import release_compiler

MOST = 1000  # messages of a call: for so long, 10 ms, timers and others may wait


def stages_of_one(nodes: Sequence[ManagedNode[Any]]) -> list[Stages]:
    """Return the stage of the only node of a process, if it has one."""
    return [Stages(alone(node.stage), [node]) for node in nodes if node.stage is not None]


class Stages:
    """Nodes of this process, and the kernel of their stages.

    ``kernel(most, wakeup, *stages, *progress)`` answers at most so many messages and returns, for
    each node, why it has stopped and how far it is; see :meth:`koop_node.node.managed.Run.lend`.
    """

    def __init__(self, kernel: Callable[..., Any], nodes: Sequence[ManagedNode[Any]]) -> None:
        self._kernel = kernel
        self._nodes = nodes
        self._rehearsed = False

    def __call__(self, executor: Executor, until: float) -> None:
        """Go on without Python as far as it goes, and wait for messages until a steady time [s].

        Raises RuntimeError if rcl cannot publish, as rclpy would.
        """
        runs, stages, progress = [], [], []
        for node in self._nodes:
            lent = node.run and node.run.lend(not self._rehearsed)
            if node.run is None or lent is None:
                return
            runs.append(node.run)
            stages.append(lent[0])
            progress.append(lent[1])
        if not self._rehearsed:  # compiled before the first message: it takes seconds
            self._kernel(0, executor.wakeup([], until), *stages, *progress)
            release_compiler()
            self._rehearsed = True
            return
        inputs = [run.reader.subscription for run in runs]
        wakeup = executor.wakeup(inputs, until)
        reached = self._kernel(MOST, wakeup, *stages, *progress)
        now = time.monotonic()
        if all(reason == IDLE for reason, _ in reached):
            now = wakeup.memory[0] + wakeup.memory[1] * 1e-9
        else:
            executor.look_again(inputs)
        for run, before, (_, after) in zip(runs, progress, reached, strict=True):
            run.take_back(before, after, now)
        for node, run, (reason, _) in zip(self._nodes, runs, reached, strict=True):
            if reason == FAILED:
                raise RuntimeError(f"{node.get_name()} cannot publish")
            run.handle(reason)
