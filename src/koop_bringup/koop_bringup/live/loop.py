"""One loop as node processes over DDS: started, watched to its end, recorded."""

from __future__ import annotations

import os
import signal
import socket
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

from koop_bag.bag.earlier import name_newest
from koop_bag.recorder.config import RecorderConfig
from koop_bringup.live.health import describe_loop, judge_health
from koop_bringup.live.monitor import Monitor, Progress
from koop_bringup.live.notify import ServiceManager
from koop_bringup.live.process import START_TIMEOUT, STOP_TIMEOUT, NodeProcess, uninterrupted
from koop_bringup.live.turns import take_turns
from koop_bringup.plan import Plan, guard_config, return_time
from koop_core.config import parameter_file
from koop_core.ended import IN_ORDER, PATH, Ended, note_end
from koop_core.errors import LiveError
from koop_core.journal import make_journal
from koop_guard.guard import Cause, Trip
from koop_guard.node.alarm import Alarm
from koop_guard.node.memory_file import open_memory_file
from koop_guard.note import THETA_LEFT, TWIN
from koop_loop.ending import Ending, ending
from koop_loop.parameters import LoopParameters
from koop_node.client.alone import TOPICS, alone, is_claimed
from koop_node.client.desk import Desk


class LiveNodes:
    """The processes of one run; a context manager that leaves none behind.

    Parameters
    ----------
    folder : Path
        Folder of the run: receives bag, logs and parameters.
    planned : Plan
        What is started; the nodes are those that have parameters.

    Attributes
    ----------
    notes : list of str
        What a reader of the results should know.
    lost : list of str
        Nodes that ended while the run went on.
    file : Path or None
        Parameter file of the loop, by which ``koop status`` may find it.
    """

    def __init__(self, folder: Path, planned: Plan) -> None:
        self.folder = folder
        self.notes: list[str] = []
        self.lost: list[str] = []
        self.file: Path | None = None
        self._values, self._namespace = planned.parameters, planned.namespace
        self._rig, self._program = planned.rig, list(planned.program)
        self._remaps, self._environment = planned.remaps, os.environ | planned.environment
        self._processes, self._journaled = planned.processes(), planned.journaled
        self._in_turn = False
        """Whether the nodes work one after the other."""
        self._nodes: dict[str, NodeProcess] = {}
        self._theta_left = ""
        """Where theta of the rig is, once the guard has ended."""
        self._ended = Ended()
        """What the logs note of the end."""
        self._told = -1
        """Descriptor of where the nodes find why the loop ends."""
        self._alarms: list[Alarm] = []  # that run
        self._begun = time.monotonic()
        self._manager = ServiceManager()
        self._place: socket.socket | None = None
        self._desk: Desk | None = None
        self._stack = ExitStack()

    def __enter__(self) -> LiveNodes:
        by_others = self._rig and not self._program
        with ExitStack() as stack:
            topics = [t for t in TOPICS if t != "state" or not by_others]
            only_guard = set(self._values) == {"koop_guard"}  # which is not a loop
            self._place = stack.enter_context(alone(self._namespace, [] if only_guard else topics))
            stack.callback(self._close_desk)
            logs = self.folder / "logs"
            logs.mkdir(parents=True, exist_ok=True)
            with suppress(OSError):
                self._told = stack.enter_context(open_memory_file("koop_ended")).fileno()
                self._environment[PATH] = f"/proc/{os.getpid()}/fd/{self._told}"
            self._note_end(self._ended)
            file = logs / "given_parameters.yaml"
            parameter_file.write(self._values, file)
            arguments = ["--ros-args", "--params-file", str(file)]
            if self._namespace:
                arguments += ["-r", f"__ns:={self._namespace}"]
            arguments += [word for rule in self._remaps for word in ("-r", rule)]
            if self._journaled:
                journal, found_by = make_journal()
                stack.callback(os.close, journal)
                self._environment |= found_by
            stack.callback(self._stop_all)
            for each in self._processes:
                name = each.executable if each.arguments else each.name
                words = [*each.arguments, *arguments]
                self._nodes[name] = NodeProcess(
                    name, words, logs / f"{name}.log", environment=self._environment
                )
            if self._program:
                companion = [sys.executable, "-m", "koop_node.process.companion"]
                self._nodes["rig"] = NodeProcess("rig", self._program, logs / "rig.log", companion)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, kind: object, error: object, where: object) -> None:
        ended = replace(self._ended, time=self._ended.time or time.time())
        if not ended.failure and isinstance(error, Exception):  # Ctrl-C is none
            ended = replace(ended, failure=str(error))
        self._note_end(ended)
        self._stack.close()
        self._told = -1
        self._note_end(replace(self._ended, theta=self._theta_left))

    @uninterrupted()
    def _stop_all(self, to_guard: int = signal.SIGTERM) -> dict[str, int]:
        """Stop the sources before the recorder, so that it records all that they said.

        The guard comes first: theta returns while all else works.
        """
        self._manager.end()
        self._end_guard(to_guard)
        return {node: process.stop() for node, process in reversed(self._nodes.items())}

    def _end_guard(self, number: int = signal.SIGTERM) -> None:
        """Stop the guard, if that was not done, and say where theta is."""
        if not self._theta_left:
            self.stop_guard(number)
            if self._theta_left:
                self._note(self._theta_left)

    @uninterrupted()
    def stop_guard(self, number: int = signal.SIGTERM) -> None:
        """Stop the guard and wait for its twin; SIGINT: an orderly end."""
        guard = self._nodes.get("koop_guard")
        if guard is None:
            return
        rig = self._nodes.get("rig")
        gone = rig is not None and rig.poll() is not None
        timeout = return_time(self._values) + STOP_TIMEOUT
        guard.stop(number, timeout)
        deadline = time.monotonic() + timeout
        while (lasts := is_claimed(f"{TWIN}{guard.process.pid}")) and time.monotonic() < deadline:
            time.sleep(0.05)
        if lasts:
            text = f"the guard's twin has not returned theta after {timeout:.0f} s"
        elif gone:
            text = "the rig's program has ended and hears no command: theta is as it left it"
        else:
            lines = [line for line in guard.last_lines(20).splitlines() if THETA_LEFT in line]
            killed = "guard and twin have ended: theta is where they left it"
            silent = killed if guard.poll() else "theta was not commanded"
            text = lines[-1].rpartition("]: ")[2] if lines else silent
        self._theta_left = text

    def silenced(self, seconds: float) -> AbstractContextManager[None]:
        """Stop guard and twin for at most so many seconds: nobody commands the rig."""
        return self._nodes["koop_guard"].stopped(seconds)

    def run(self, on_progress: Callable[[Progress], None]) -> None:
        """Wait until the plant has done its steps, then stop the other nodes.

        Raises
        ------
        LiveError
            If a node ends before its time or with an exit code other than 0.
        KeyboardInterrupt
            If ``koop status --stop`` asks for it.
        """
        started = time.monotonic()
        state, alone_on_it = f"{self._namespace}/state", True
        with Monitor(self._namespace) as monitor:
            while not self._done():
                monitor.spin(0.05)
                for alarm in self._alarms:
                    alarm.check()
                on_progress(monitor.progress)
                self._report(monitor.progress)
                self.answer(partial(self._describe, monitor.progress))
                if self._in_turn and monitor.progress.step:
                    self._in_turn = False
                    pids = self.process_ids()
                    take_turns(
                        [pid for node, pid in pids.items() if node != "recorder"],
                        [pid for node, pid in pids.items() if node == "recorder"],
                    )
                if alone_on_it and monitor.node.count_publishers(state) > 1:
                    alone_on_it = False
                    self._note(
                        f"another loop has joined the ROS domain at step "
                        f"{monitor.progress.step}: this one goes on, but hears its messages"
                    )
                silent = monitor.progress.step == 0 and not self._rig  # a rig may come later
                if silent and time.monotonic() - started > START_TIMEOUT:
                    raise LiveError(
                        f"the loop did not start in {START_TIMEOUT:g} s: see {self.folder}/logs"
                    )
        self.end()

    def answer(self, describe: Callable[[], dict[str, Any]]) -> None:
        """Answer ``koop status``; raise KeyboardInterrupt where it asks for the end."""
        if self._desk is None and self._place is not None:
            self._desk = Desk(self._place)
        if self._desk is not None and self._desk.answer(describe):
            raise KeyboardInterrupt

    def _report(self, progress: Progress) -> None:
        """Tell the service manager that the loop goes on, if it does."""
        if not self._manager.listens:
            return
        faults = judge_health(progress, self._values, self.lost, time.monotonic())
        nodes = [node for node in self._values if node not in self.lost]
        self._manager.report(progress, nodes, "; ".join(faults) or "healthy")

    def _describe(self, progress: Progress) -> dict[str, Any]:
        """Return the answer to ``koop status``."""
        now = time.monotonic()
        faults = judge_health(progress, self._values, self.lost, now)
        recorded = "recorder" in self._values and "recorder" not in self.lost
        text = describe_loop(
            progress, faults, self._values, self.folder, recorded, now - self._begun, now
        )
        places = [str(path.resolve()) for path in (self.folder, self.file) if path is not None]
        guarded = "koop_guard" in self._values
        guard = progress.values.get("koop_guard", {}).get("status", "")
        state = {"guarded": guarded, "guard": guard}
        return {"healthy": not faults, "text": text, "places": places, **state}

    def _close_desk(self) -> None:
        if self._desk is not None:
            self._desk.close(self._theta_left or "theta was not guarded")

    def end(self) -> None:
        """Stop all that runs.

        Raises
        ------
        LiveError
            If a node then ends with an exit code other than 0.
        """
        for node, code in self._stop_all(signal.SIGINT).items():
            if code and node not in self.lost:
                raise self._nodes[node].failure()

    def process_ids(self) -> dict[str, int]:
        """Return the id of every process, by node; all composed nodes are in ``container``."""
        return {node: process.process.pid for node, process in self._nodes.items()}

    def ended(self) -> list[NodeProcess]:
        """Return the nodes that have ended on their own."""
        return [process for process in self._nodes.values() if process.poll() is not None]

    def _done(self) -> bool:
        """Return whether the run has come to its end; raise if it is the wrong one."""
        for node, process in self._nodes.items():
            code = process.poll()
            if code is None or node in self.lost:
                continue
            role = self._processes[-1].name if node == "container" else node
            end = ending(role, code, self._rig)
            if end is Ending.DONE:
                return True
            if end is Ending.FAILED:
                self._note_end(replace(self._ended, time=time.time(), failure=process.end()))
                self._end_guard()  # the recorder still works
                raise process.failure()
            self.lost.append(node)
            lost = (*self._ended.lost, (time.time(), process.end()))
            self._note_end(replace(self._ended, lost=lost))
            self._note(f"{process.failure()}\nthe loop goes on without it")
            if code < 0 and (self.folder / "summary").is_dir():
                name_newest(self.folder / "bag")
            self._sound(node, process.end())
        return False

    def _sound(self, node: str, how: str) -> None:
        """Run the rig's alarm for a node without which the loop goes on: nobody may look."""
        config = guard_config(self._values)
        if config is not None:
            alarm = Alarm(config, self._note)
            text = f"{how}: the loop goes on without it"
            alarm.start(Trip(Cause.ENDED, text, time.monotonic(), (), ()), node)
            self._alarms.append(alarm)

    def _note_end(self, ended: Ended) -> None:
        """Let the logs tell how the loop ended, so far."""
        self._ended = ended
        if self._told >= 0 and ended.time:
            os.pwrite(self._told, (ended.failure or IN_ORDER).encode(), 0)
        with suppress(LiveError):  # a full disk ends no loop
            note_end(self.folder / "logs", ended)

    def _note(self, text: str) -> None:
        self.notes.append(text)
        print(f"\nnote: {text}", file=sys.stderr)


class LiveLoop(LiveNodes):
    """The node processes of a simulated run that is recorded; its folder is the recorder's output.

    Composed, the three nodes share one process.
    """

    def __init__(
        self,
        folder: Path,
        parameters: LoopParameters,
        recorder: RecorderConfig = RecorderConfig(),  # noqa: B008 - it is frozen
        composed: bool = False,
    ) -> None:
        values = parameters.as_ros()
        for section in values.values():
            section["listeners"] = "next recorder"
        values["recorder"] = asdict(replace(recorder, output=str(folder)))
        super().__init__(folder, Plan(values, composed=composed))
        self._in_turn = parameters.pace.pace == "lockstep"
