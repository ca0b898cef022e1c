"""The compiled stages of the nodes of a process: one node's, or those of its loops.

What a node does with a message that follows on the last one is the same for ever: it takes it, runs
its kernel, publishes the answer, waits. That is compiled, with rcl's own functions; every message
goes through DDS as ever. What is not plain (another layout, a gap, a join, the last step) goes to
the node, in Python, before anything is done with it; so does all else that happens: timers,
services, signals.

Compiled code keeps what it needs of a node until Python has something to do with the node: whoever
calls it back takes that back first, by :meth:`koop_node.node.managed.ManagedNode.take_back`.
"""

from __future__ import annotations

import gc
import os
import time
from collections.abc import Sequence
from functools import partial
from typing import Any

from koop_core.borrowed import kind_of
from koop_core.kernels import Kernel
from koop_core.port import FAILED, IDLE, MORE
from koop_core.wakeup import NEVER, NOW, Loop, alone, get, make_run, make_turns, put
from koop_node.node.executor import AT_ONCE, Executor
from koop_node.node.managed import REPORT_PERIOD, ManagedNode, Run
from koop_node.process.housekeeping import release_compiler

MOST = 1000  # messages of a call: for so long, 10 ms, timers and others may wait


def stages_of_one(nodes: Sequence[ManagedNode[Any]]) -> list[Stages]:
    """Return the stage of the only node of a process, if it has one."""
    return [Stages(alone(n.stage, n.due), [[n]]) for n in nodes if n.stage is not None]


class Stages:
    """The loops of this process, each a row of nodes, and the kernel that goes on with one.

    See :func:`koop_core.wakeup.make_run` and :meth:`koop_node.node.managed.Run.lend`.
    """

    def __init__(self, go_on: Kernel, loops: Sequence[Sequence[ManagedNode[Any]]]) -> None:
        self._run = make_run(go_on)
        self._loops = loops
        self._turns = make_turns(len(loops), len(loops[0]))
        self._lent: dict[int, tuple[list[Run], Loop]] = {}
        self._kind: Any = None  # the type of what is lent of a loop
        self._looked = 0.0  # steady time [s] up to which there were messages
        now = time.monotonic()
        for number, nodes in enumerate(loops):
            for node in nodes:
                node.take_back = partial(self.take_back, number)
                # the nodes of a loop report together, as it is taken back as a whole
                node.reporter.restart(due=now + REPORT_PERIOD * (1 + number / len(loops)))

    @property
    def due(self) -> float:
        """Steady time [s] of the next tick of compiled code."""
        return float(self._turns.due.min())

    def __call__(self, executor: Executor, until: float) -> None:
        """Go on without Python as far as it goes, and wait for messages until a steady time [s].

        Raises RuntimeError if rcl cannot publish, as rclpy would.
        """
        for number in range(len(self._loops)):
            if number not in self._lent:
                self._lend(number, executor)
        if not self._lent:
            return
        wakeup, turns = executor.wakeup(until), self._turns
        self._run(MOST, wakeup, turns, self._kind)
        seconds, nanoseconds = wakeup.clock.memory.tolist()
        self._looked = seconds + nanoseconds * 1e-9
        for number in (turns.reasons.max(axis=1) > MORE).nonzero()[0].tolist():
            runs, reasons = self._lent[number][0], turns.reasons[number].tolist()
            self.take_back(number)
            for node, run, reason in zip(self._loops[number], runs, reasons, strict=True):
                if reason == FAILED:
                    raise RuntimeError(f"{node.get_name()} cannot publish")
                run.handle(reason)

    def take_back(self, number: int) -> None:
        """Let a loop's nodes go on where the compiled code ended, with what it has not taken."""
        if number not in self._lent:
            return
        runs, loop = self._lent.pop(number)
        turns = self._turns
        turns.lent[number], turns.due[number], turns.reasons[number] = False, NEVER, IDLE
        now = get(turns, number, self._kind)
        for run, before, after in zip(runs, loop.progress, now, strict=True):
            run.take_back(before, after, self._looked)
        for descriptor in turns.descriptors[number].tolist():
            os.eventfd_write(descriptor, AT_ONCE)

    def _lend(self, number: int, executor: Executor) -> None:
        """Lend a loop if all of its nodes can."""
        runs: list[Run] = []
        lent: list[tuple[Any, Any]] = []
        for node in self._loops[number]:
            each = node.run and node.run.lend(self._kind is None)
            if node.run is None or each is None:
                break
            runs.append(node.run)
            lent.append(each)
        else:
            loop, turns = Loop(*zip(*lent, strict=True)), self._turns
            if self._kind is None:  # compiled before the first message: it takes seconds
                kind = self._kind = kind_of(loop)
                put(turns, number, loop, kind)
                get(turns, number, kind)
                self._run(0, executor.wakeup(0.0), turns, kind)
                release_compiler()
                gc.freeze()  # what has come with it is looked through at every collection else
            elif self._put(number, loop):
                readers = [run.reader for run in runs]
                turns.descriptors[number] = [
                    executor.descriptor(each.subscription) if each else -1 for each in readers
                ]
                turns.lent[number], turns.due[number] = True, NOW
                self._lent[number] = runs, loop
                return
        for run, (_, same) in zip(runs, lent, strict=True):
            run.take_back(same, same, self._looked)

    def _put(self, number: int, loop: Loop) -> bool:
        """Lend a loop, of another type only where no other is lent; return whether it is.

        To look at the type in Python takes milliseconds: it is done where it has changed.
        """
        if put(self._turns, number, loop, self._kind):
            return True
        if self._lent:
            return False
        self._kind = kind_of(loop)
        return bool(put(self._turns, number, loop, self._kind))
