"""One loop as node processes over DDS: started, watched to its end, recorded."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from types import TracebackType

from koop_bag.recorder.config import RecorderConfig
from koop_lab.live.monitor import Monitor, Progress
from koop_lab.live.process import START_TIMEOUT, NodeProcess, uninterrupted
from koop_loop.ending import Ending, ending
from koop_loop.parameters import EXECUTABLES, LoopParameters
from koop_node import parameter_file
from koop_node.alone import alone
from koop_node.errors import LiveError


class LiveLoop:
    """The node processes of one run; a context manager that leaves no process behind.

    Parameters
    ----------
    folder : Path
        Of the run: receives bag, logs and parameters.
    parameters : LoopParameters
        Of the three nodes.
    recorder : RecorderConfig
        Of the recorder; its output is the folder, whatever it says.

    Attributes
    ----------
    notes : list of str
        What a reader of the results should know.
    """

    def __init__(
        self,
        folder: Path,
        parameters: LoopParameters,
        recorder: RecorderConfig = RecorderConfig(),  # noqa: B008 - it is frozen
    ) -> None:
        self.folder = folder
        self.notes: list[str] = []
        self._parameters = parameters
        self._recorder = replace(recorder, output=str(folder))
        self._nodes: dict[str, NodeProcess] = {}
        self._stack = ExitStack()

    def __enter__(self) -> LiveLoop:
        with ExitStack() as stack:
            stack.enter_context(alone())
            logs = self.folder / "logs"
            logs.mkdir(parents=True, exist_ok=True)
            given = {
                node: {**values, "recorders": 1}
                for node, values in self._parameters.as_ros().items()
            }
            file = logs / "given_parameters.yaml"
            parameter_file.write({**given, "recorder": asdict(self._recorder)}, file)
            stack.callback(self._stop_all)
            for node in EXECUTABLES:
                arguments = ["--ros-args", "--params-file", str(file)]
                self._nodes[node] = NodeProcess(node, arguments, logs / f"{node}.log")
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    @uninterrupted()
    def _stop_all(self) -> dict[str, int]:
        """Stop the sources before the recorder, so that it records all that they said."""
        return {node: process.stop() for node, process in reversed(self._nodes.items())}

    def run(self, on_progress: Callable[[Progress], None]) -> None:
        """Wait until the plant has done its steps, then stop the other nodes.

        Raises
        ------
        LiveError
            If a node ends before its time or with an exit code other than 0.
        """
        started = time.monotonic()
        with Monitor() as monitor:
            while not self._done():
                monitor.spin(0.2)
                on_progress(monitor.progress)
                if monitor.count_publishers("state") > 1 and not self.notes:
                    self._note(
                        f"another loop has joined the ROS domain at step "
                        f"{monitor.progress.step}: this one goes on, but hears its messages"
                    )
                if monitor.progress.step == 0 and time.monotonic() - started > START_TIMEOUT:
                    raise LiveError(
                        f"the loop did not start in {START_TIMEOUT:g} s: see {self.folder}/logs"
                    )
        self._stop_all()
        for process in self._nodes.values():
            if process.poll() != 0:
                raise process.failure()

    def _done(self) -> bool:
        """Return whether the run has come to its end; raise if it is the wrong one."""
        for node, process in self._nodes.items():
            code = process.poll()
            if code is not None:
                if ending(node, code, rig=False) is Ending.DONE:
                    return True
                raise process.failure()
        return False

    def _note(self, text: str) -> None:
        self.notes.append(text)
        print(f"\nnote: {text}", file=sys.stderr)
