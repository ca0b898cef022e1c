"""Nodes as processes of their own: started, watched, stopped, and none left behind.

rclpy is imported only where it is used, so that the offline commands run without ROS.
"""

from __future__ import annotations

import os
import signal
import subprocess
import time
import weakref
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

from koop_core.errors import LiveError
from koop_guard.note import STOOD_STILL
from koop_loop.ending import describe_end
from koop_loop.parameters import CONTAINER, EXECUTABLES
from koop_node.process.lifeline import OWN_GROUP, TIED, deferred_signals

START_TIMEOUT = 300.0  # [s] for imports and, the first time, for the compilation of the kernels
RESUMED = 1.0  # [s] in which a stopped process that goes on gives a sign of life
STOP_TIMEOUT = 10.0  # [s] after which a node that ignores SIGINT is killed


def executable(node: str) -> str:
    """Return the path of a node's executable, or of the container's, as ros2 run finds it."""
    from ament_index_python.packages import PackageNotFoundError, get_package_prefix

    package, name = {**EXECUTABLES, "container": CONTAINER}[node]
    try:
        path = Path(get_package_prefix(package)) / "lib" / package / name
    except PackageNotFoundError:
        raise LiveError(f"package {package} is not built: run './koop setup'") from None
    if not path.is_file():
        raise LiveError(f"package {package} has no executable {name}: run './koop setup'")
    return str(path)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Ignore Ctrl-C and its like: pressed twice, it would leave the nodes behind, running."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = [signal.signal(number, signal.SIG_IGN) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


class TiedProcess(subprocess.Popen[bytes]):
    """A process that ends with this one, however this one ends.

    Its program calls ``end_with_parent``, as every node does: :mod:`koop_node.process.lifeline`.
    """

    def __init__(
        self, command: list[str], environment: Mapping[str, str] | None = None, **options: Any
    ) -> None:
        reader, writer = os.pipe()
        weakref.finalize(self, os.close, writer)
        try:
            env = {**(os.environ if environment is None else environment), **TIED}
            super().__init__(command, stdin=reader, env=env, **options)
        finally:
            os.close(reader)


class NodeProcess:
    """One node in a process of its own, its output in a log file.

    Parameters
    ----------
    node : str
        Name for the reports; without a command, the node that is started.
    arguments : list of str
        Arguments of the program.
    log : Path
        File for its output.
    command : list of str, optional
        The program, if it is not the node's executable.
    environment : mapping of str to str, optional
        Environment in place of this process's own.
    before : sequence of str
        Words before the command, of a program that starts it in another place.
    """

    def __init__(
        self,
        node: str,
        arguments: list[str],
        log: Path,
        command: list[str] | None = None,
        environment: Mapping[str, str] | None = None,
        before: tuple[str, ...] = (),
    ) -> None:
        self.node = node
        self.log = log
        words = [*before, *(command or [executable(node)]), *arguments]
        # a program of others would never take the signals that wait
        waiting = deferred_signals() if command is None else nullcontext()
        with open(log, "ab") as output, waiting:
            self.process = TiedProcess(
                words, environment, stdout=output, stderr=subprocess.STDOUT, **OWN_GROUP
            )

    def poll(self) -> int | None:
        """Return the exit code, or None while the process runs."""
        return self.process.poll()

    def ask_to_stop(self, number: int = signal.SIGINT) -> None:
        """Ask the process to end, and do not wait."""
        if self.process.poll() is None:
            self.process.send_signal(number)

    @uninterrupted()
    def stop(self, number: int = signal.SIGINT, timeout: float = STOP_TIMEOUT) -> int:
        """Ask the process to end, wait, kill it if it does not; return the exit code.

        It is 0 where the process had done its work and hung as it left the ROS domain.
        """
        self.ask_to_stop(number)
        try:
            self.process.wait(timeout)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        code = self.process.returncode
        return 0 if code == -signal.SIGALRM else code

    @contextmanager
    def stopped(self, seconds: float) -> Iterator[None]:
        """Stop the process and its children, as by SIGSTOP, for at most so many seconds.

        A program of its own lets them go on then, for this one may be killed meanwhile. The process
        goes on first, so that a child which watches it sees it alive.
        """
        main = self.process.pid
        children = [int(w) for w in Path(f"/proc/{main}/task/{main}/children").read_text().split()]
        later = f"kill -CONT {main}; sleep {RESUMED:g}; kill -CONT {' '.join(map(str, children))}"
        waiting = subprocess.Popen(
            ["sh", "-c", f"sleep {seconds:g}; {later}"],
            stdin=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        try:
            for pid in (*children, main):
                os.kill(pid, signal.SIGSTOP)
            yield
        finally:
            with uninterrupted():
                self.ask_to_stop(signal.SIGCONT)
                time.sleep(RESUMED)
                for pid in children:
                    with suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGCONT)
                os.killpg(waiting.pid, signal.SIGKILL)
                waiting.wait()

    def last_lines(self, count: int = 5) -> str:
        """Return the end of the node's output."""
        return "\n".join(self.log.read_text(errors="replace").splitlines()[-count:])

    def end(self) -> str:
        """Return how the process ended, in words."""
        code = self.process.poll()
        if code is None:
            return f"{self.node} has not ended"
        lines = self.last_lines(20).splitlines() if code == -signal.SIGKILL else []
        still = [line for line in lines if line.startswith(STOOD_STILL)]
        return ": ".join([describe_end(self.node, code), *still[:1]])

    def failure(self) -> LiveError:
        """Return the error that says how the process ended, with its last words."""
        code, end = self.process.poll(), self.end()
        # who is killed has said nothing about it
        words = "" if code == -signal.SIGKILL else f":\n{self.last_lines()}"
        return LiveError(f"{end}{words}\n({self.log})")
