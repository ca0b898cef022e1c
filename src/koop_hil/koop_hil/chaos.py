"""``koop hil chaos``: faults at random, overlapping, on ``koop up`` with a rig of its own.

The rig is on another DDS and keeps a log. ``koop up`` is started again whenever it has ended, as a
service manager does it, and the guard is rearmed when the cause of its trip is gone, as an
operator does it. :mod:`koop_hil.chaos_verdict` judges from the files alone.
"""

from __future__ import annotations

import contextlib
import heapq
import itertools
import json
import os
import random
import resource
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple

from tqdm import tqdm

from koop_core.config import parameter_file
from koop_core.config.parameter import ConfigError
from koop_core.errors import LiveError
from koop_hil import installed
from koop_node.client.client import Client
from koop_node.process.domain import current_domain

PROCESSES = {
    "controller": "/lib/relay_esc/",
    "lifter": "/lib/koopman_lifter/",
    "guard": "/lib/koop_guard/",
    "twin": "koop_guard.node.twin",
    "recorder": "/lib/koop_bag/",
}
"""Words by which each process is found: its command contains them."""

UP = "koop up"
EVERY = 3.0  # [s] mean time between two faults
LASTS = (0.2, 5.0)  # [s] of a fault, least and most
STARTED, ENDED = 60.0, 90.0  # [s] for a loop to start, and to end
MARK = "KOOP_CHAOS"  # in the environment of every process
BYTES = 1 << 22  # of the address space, beyond what a process has, that it may still take
MEASURED, COMMAND = "/rig/state:position[0],position[1]", "/rig/theta"
LOOP: dict[str, dict[str, Any]] = {
    "koopman_lifter": {"measured": MEASURED, "omega_l": 20.0},
    "relay_esc": {
        "step_size": 0.004, "theta_min": -2.5, "theta_max": 3.5, "theta_initial": 1.8,
        "rate_limit": 4.0, "tau_f": 0.2, "dwell": 0.2,
    },
    "koop_guard": {
        "measured": MEASURED, "command": f"{COMMAND}:data", "theta_min": -3.0, "theta_max": 4.0,
        "theta_rate": 4.0, "theta_start": 2.0, "theta_safe": 2.0,
        "channel_min": [-50.0, -50.0], "channel_max": [50.0, 50.0],
    },
}  # fmt: skip
"""The loop under test, and what the guard knows of the rig ``rigs/faulty.py``."""

SENSOR = (
    "dead", "stuck", "biased", "spiking", "nan", "quantised", "delayed", "doubled", "lossy",
    "clock", "cut",
)  # fmt: skip


class TimedFault(NamedTuple):
    """A fault of a run."""

    at: float
    lasts: float
    """Begin after the run's begin, and duration [s]."""
    kind: str
    """One of :data:`KINDS`."""


class Operator(Client):
    """Rearms the guard when the cause of its trip is gone, and publishes where it must not."""

    def __init__(self, note: Callable[..., None]) -> None:
        from koop_msgs.msg import ControlInput, GuardState
        from std_msgs.msg import Float64
        from std_srvs.srv import Trigger

        from koop_node.node.qos import KEPT

        super().__init__("_koop_chaos")
        self._note = note
        self._types = {COMMAND: Float64, "/theta": ControlInput}
        self._others: dict[str, Any] = {}
        self._state = GuardState()
        self.node.create_subscription(GuardState, "/koop_guard/state", self._on_state, KEPT)
        self._rearm = self.node.create_client(Trigger, "/koop_guard/rearm")
        self._request = Trigger.Request()
        self._asked = 0.0

    def _on_state(self, state: Any) -> None:
        if state.status == state.TRIPPED and self._state.status != state.TRIPPED:
            self._note("tripped", cause=state.cause)
        self._state = state

    @property
    def follows(self) -> bool:
        """Whether the guard follows the controller."""
        return bool(self._state.status == self._state.FOLLOWING)

    def rearm(self) -> None:
        """Ask for a rearm, once a second, if the guard would not refuse it."""
        if self._state.status != self._state.TRIPPED or self._state.rearm_refused:
            return
        if time.monotonic() > self._asked + 1.0 and self._rearm.service_is_ready():
            self._asked = time.monotonic()
            self._rearm.call_async(self._request)

    def publish_beside(self, topic: str, on: bool) -> None:
        """Begin to publish theta_safe on a topic that another publishes on, or end it."""
        if on and topic not in self._others:
            self._others[topic] = self.node.create_publisher(self._types[topic], topic, 10)
        elif not on and topic in self._others:
            self.node.destroy_publisher(self._others.pop(topic))

    def publish(self) -> None:
        """Publish once on every such topic."""
        for topic, publisher in self._others.items():
            theta = LOOP["koop_guard"]["theta_safe"]
            value = {"data": theta} if topic == COMMAND else {"theta": [theta]}
            publisher.publish(self._types[topic](**value))


class ChaosRun:
    """The rig, the loop under test, and what acts on them; a context manager."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.loops = 0
        self.random = random.Random(0)
        if folder.exists():
            raise ConfigError(f"{folder} is there already: choose another --out")
        folder.mkdir(parents=True)
        self.parameters, self.model = folder / "loop.yaml", folder / "model.npz"
        self.model.write_bytes((installed("models") / "galloping.npz").read_bytes())
        lifter = {**LOOP["koopman_lifter"], "model": str(self.model)}
        parameter_file.write({**LOOP, "koopman_lifter": lifter}, self.parameters)
        self.parameters.write_text(self.parameters.read_text().replace("/**/", "/"))
        self._whole = {file: file.read_bytes() for file in (self.parameters, self.model)}
        self._environment = {**os.environ, MARK: str(folder)}
        self._events: IO[str] = (folder / "events.jsonl").open("w", buffering=1)
        self._loop: subprocess.Popen[bytes] | None = None
        self.begun = 0.0  # steady clock at the start of the loop [s]
        self._rig = self._start_rig()
        self.operator = Operator(self.note)

    def __enter__(self) -> ChaosRun:
        return self

    def __exit__(self, *error: object) -> None:
        if self._loop is not None and self._loop.poll() is None:
            self.signal(UP, signal.SIGCONT)
            self._loop.send_signal(signal.SIGTERM)  # SIGINT may be ignored
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._loop.wait(ENDED)
        self.note("loop ended", code=self._loop and self._loop.poll())
        self.operator.close()
        self._rig.communicate(timeout=10.0)
        deadline = time.monotonic() + 10.0
        while (left := list(self.marked())) and time.monotonic() < deadline:
            time.sleep(0.1)
        self.note("end", left=[words for _, words in left])
        for pid, _ in left:
            with contextlib.suppress(OSError):
                os.kill(pid, signal.SIGKILL)
        self._events.close()

    def note(self, what: str, **facts: Any) -> None:
        """Write a line of what was done."""
        self._events.write(json.dumps({"time": time.time(), "what": what, **facts}) + "\n")

    def settle(self) -> bool:
        """Wait until the guard follows the controller; return whether it does."""
        self.watch()
        deadline = time.monotonic() + STARTED
        while not self.operator.follows and time.monotonic() < deadline:
            self.operator.spin(0.05)
            self.operator.rearm()
            self.watch()
        return self.operator.follows

    def watch(self) -> None:
        """Start the loop, again when it has ended; note how it ended."""
        if self._loop is not None:
            if (code := self._loop.poll()) is None:
                return
            self.note("loop ended", code=code)
        self.loops, self.begun = self.loops + 1, time.monotonic()
        with (self.folder / f"loop-{self.loops}.log").open("w") as log:
            command = [sys.executable, "-m", "koop_lab", "up", str(self.parameters)]
            command += ["--out", str(self.folder / f"loop-{self.loops}")]
            self._loop = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=self._environment
            )
        self.note("loop started", number=self.loops)

    def marked(self) -> Iterator[tuple[int, str]]:
        """Yield id and command of every process of the run besides the rig's and this one."""
        mark = f"{MARK}={self.folder}".encode()
        for pid in filter(str.isdigit, os.listdir("/proc")):
            with contextlib.suppress(OSError):
                environment = Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
                words = Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
                if mark in environment and words and "faulty.py" not in words:
                    yield int(pid), words

    def pids(self, name: str) -> list[int]:
        """Return the ids of a process of the loop: one, or none while it does not run."""
        if name == UP:
            running = self._loop is not None and self._loop.poll() is None
            return [self._loop.pid] if self._loop and running else []
        return [pid for pid, words in self.marked() if PROCESSES[name] in words]

    def signal(self, name: str, number: int) -> None:
        """Send a signal to a process of the loop."""
        for pid in self.pids(name):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, number)

    def limit(self, name: str, kind: int, value: Callable[[int], int]) -> None:
        """Limit a resource of a process of the loop to a value that its id gives."""
        for pid in self.pids(name):
            with contextlib.suppress(OSError):
                _, hard = resource.prlimit(pid, kind)
                resource.prlimit(pid, kind, (value(pid), hard))

    def sensor(self, name: str, on: bool) -> None:
        """Begin or end a fault of the rig."""
        assert self._rig.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._rig.stdin.write(f"{name} {int(on)}\n")
            self._rig.stdin.flush()

    def restart_rig(self) -> None:
        """Kill the rig and start it again."""
        self._rig.kill()
        self._rig.wait()
        self._rig = self._start_rig()

    def damage(self, file: Path, on: bool) -> None:
        """Cut a file of the loop in half, or mend it."""
        whole = self._whole[file]
        file.write_bytes(whole[: len(whole) // 2] if on else whole)

    def memory(self) -> dict[str, int]:
        """Return the resident memory [kB] of the loop's processes."""
        pages = {}
        for name in (UP, *PROCESSES):
            for pid in self.pids(name):
                with contextlib.suppress(OSError, IndexError):
                    pages[name] = int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * 4
        return pages

    def _start_rig(self) -> subprocess.Popen[str]:
        words = [sys.executable, str(installed("rigs") / "faulty.py"), str(self.folder / "rig.csv")]
        with (self.folder / "rig.log").open("a") as log:
            return subprocess.Popen(
                words, stdin=subprocess.PIPE, stderr=log, text=True, env=self._environment
            )


def _address_space(pid: int) -> int:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[0]) * 4096 + BYTES


KINDS = (
    *(f"kill {name}" for name in (*PROCESSES, UP)),
    *(f"stop {name}" for name in (*PROCESSES, UP)),
    *(f"sensor {name}" for name in SENSOR),
    "second controller", "second commander", "rig restarted", "network flooded", "disk full",
    "no memory for controller", "no memory for recorder", "parameter file damaged",
    "model file damaged",
)  # fmt: skip


def act(run: ChaosRun, kind: str, on: bool) -> None:
    """Begin or end a fault of a kind."""
    first, _, rest = kind.partition(" ")
    match first:
        case "kill" if on:
            run.signal(rest, signal.SIGKILL)
        case "stop":
            run.signal(rest, signal.SIGSTOP if on else signal.SIGCONT)
        case "sensor":
            run.sensor(rest, on)
        case "second":
            run.operator.publish_beside("/theta" if rest == "controller" else COMMAND, on)
        case "rig" if on:
            run.restart_rig()
        case "network" if on:
            flood(run.random.randbytes(1200))
        case "disk":
            most = 1 if on else resource.RLIM_INFINITY
            run.limit("recorder", resource.RLIMIT_FSIZE, lambda _: most)
        case "no":
            _, all_of_it = resource.prlimit(0, resource.RLIMIT_AS)
            most_of = _address_space if on else lambda _: all_of_it
            run.limit(rest.removeprefix("memory for "), resource.RLIMIT_AS, most_of)
        case "parameter" | "model":
            run.damage(run.parameters if first == "parameter" else run.model, on)


def flood(noise: bytes) -> None:
    """Send datagrams of noise to the ports of the domain's participants."""
    first = 7400 + 250 * current_domain() + 10
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        for i in range(20000):
            with contextlib.suppress(OSError):
                out.sendto(b"RTPS\x02\x03" + noise, ("127.0.0.1", first + i % 40))


TARGETS = {kind: name for name in (*PROCESSES, UP) for kind in KINDS if kind.endswith(f" {name}")}
TARGETS["disk full"] = "recorder"
"""The process that a fault needs."""


def draw(seed: int, count: int) -> list[TimedFault]:
    """Return faults at random times, every kind as often as another, in order of time.

    >>> draw(1, 3) == draw(1, 3)
    True
    """
    rng = random.Random(seed)
    kinds = list(KINDS) * (count // len(KINDS)) + rng.sample(KINDS, count % len(KINDS))
    rng.shuffle(kinds)
    begins = itertools.accumulate(rng.expovariate(1.0 / EVERY) for _ in kinds)
    return [
        TimedFault(at, rng.uniform(*LASTS), kind) for at, kind in zip(begins, kinds, strict=True)
    ]


def run(folder: Path, seed: int, count: int) -> None:
    """Run the loop through so many faults; what happened is in the folder.

    Raises ConfigError if that is there already, LiveError if the loop does not run at first.
    """
    with ChaosRun(folder) as it, tqdm(total=count, desc="chaos", unit="fault", disable=None) as bar:
        if not it.settle():
            raise LiveError(f"the loop does not run: see {folder}/loop-1.log")
        begin = time.monotonic()
        order = itertools.count()
        todo = [(fault.at, next(order), fault.kind, fault.lasts) for fault in draw(seed, count)]
        heapq.heapify(todo)
        looked = 0.0
        while todo:
            it.operator.spin(0.02)
            it.operator.publish()
            it.operator.rearm()
            now = time.monotonic() - begin
            if now > looked + 1.0:
                looked = now
                it.watch()
            if todo[0][0] > now:
                continue
            _, _, kind, lasts = heapq.heappop(todo)
            if lasts > 0.0 and kind in TARGETS and not it.pids(TARGETS[kind]):
                if not todo and time.monotonic() > it.begun + STARTED:  # it lacks its recorder
                    it.signal(UP, signal.SIGTERM)
                heapq.heappush(todo, (now + 1.0, next(order), kind, lasts))  # it is not there now
                continue
            it.note("fault", kind=kind, on=lasts > 0.0, memory=it.memory())
            act(it, kind, lasts > 0.0)
            if lasts > 0.0:
                heapq.heappush(todo, (now + lasts, next(order), kind, 0.0))
                bar.update()
        it.note("settled", follows=it.settle())
