"""The processes of a scenario: started, killed, paused, started again, and none left behind."""

from __future__ import annotations

import os
import shlex
import signal
import sys
from pathlib import Path

from koop_bringup.live.process import NodeProcess
from koop_core.config import parameter_file
from koop_core.errors import LiveError
from koop_hil import installed
from koop_hil.hosts import OtherHost
from koop_hil.scenario import SECOND, Scenario

ORDER = (
    "recorder",
    "relay_esc",
    SECOND,
    "koopman_lifter",
    "fault_injector",
    "plant",
)  # listeners first


def rig_script() -> Path:
    """Return the program of the simulated rigs, which imports nothing of this workspace."""
    return installed("rigs") / "rig.py"


class Processes:
    """The nodes of one scenario run; a context manager.

    Parameters
    ----------
    folder : Path
        Of the run: bag, logs, parameters.
    scenario : Scenario
        What to run.
    other_host : OtherHost, optional
        Where the scenario's remote process runs.
    """

    def __init__(
        self,
        folder: Path,
        scenario: Scenario,
        other_host: OtherHost | None = None,
    ) -> None:
        self._folder = folder
        self._scenario = scenario
        self._other_host = other_host
        self._running: dict[str, NodeProcess] = {}
        self.failures: list[str] = []  # of those that were stopped
        self._parameter_file = self.logs / "given_parameters.yaml"

    @property
    def logs(self) -> Path:
        """Folder of the processes' output."""
        return self._folder / "logs"

    def __enter__(self) -> Processes:
        self._parameter_file.parent.mkdir(parents=True, exist_ok=True)
        parameter_file.write(self._given(), self._parameter_file)
        try:
            for name in ORDER:
                if self._wanted(name):
                    self.start(name)
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _wanted(self, name: str) -> bool:
        optional = {
            "fault_injector": self._scenario.injects,
            SECOND: self._scenario.second_controller,
        }
        return optional.get(name, True)

    def start(self, name: str) -> None:
        """Start a process of the scenario."""
        log = self.logs / f"{name}.log"
        arguments, command = self._command(name)
        node = name if command else {"plant": "vdp_plant", SECOND: "relay_esc"}.get(name, name)
        there = self._other_host is not None and name == self._scenario.setting.remote
        before = tuple(self._other_host.words) if there and self._other_host else ()
        self._running[name] = NodeProcess(node, arguments, log, command, before=before)

    def kill(self, name: str) -> None:
        """End a process as a power cut would."""
        process = self._running.pop(name)
        process.process.kill()
        process.stop()

    def pause(self, name: str, paused: bool) -> None:
        """Stop a process with SIGSTOP, or let it go on."""
        self._running[name].process.send_signal(signal.SIGSTOP if paused else signal.SIGCONT)

    def dead(self) -> list[str]:
        """Return the processes that ended on their own."""
        return [name for name, process in self._running.items() if process.poll() is not None]

    def refuse_dead(self) -> None:
        """Raise LiveError if a process ended on its own."""
        for name in self.dead():
            raise LiveError(self.end(name))

    def memory(self) -> dict[str, float]:
        """Return the resident memory of every process [MB]."""
        sizes = {}
        for name, process in self._running.items():
            try:
                pages = Path(f"/proc/{process.process.pid}/statm").read_text().split()[1]
            except (OSError, IndexError):
                continue
            sizes[name] = int(pages) * os.sysconf("SC_PAGE_SIZE") / 1e6
        return sizes

    def end(self, name: str) -> str:
        """Return how a process ended, with its last lines."""
        return str(self._running[name].failure())

    def close(self) -> None:
        """Stop all, the sources before the recorder."""
        for name in reversed(ORDER):
            if name in self._running:
                process = self._running.pop(name)
                process.process.send_signal(signal.SIGCONT)
                if process.stop() != 0:
                    self.failures.append(str(process.failure()))

    def _given(self) -> dict[str, dict[str, object]]:
        setting = self._scenario.setting
        given: dict[str, dict[str, object]] = {
            "vdp_plant": {
                "pace": setting.pace,
                "time_scale": setting.time_scale,
                "theta_initial": setting.theta_initial,
                "seed": setting.seed,
            },
            "koopman_lifter": {"model": setting.model} if setting.model else {},
            "relay_esc": {"theta_initial": setting.theta_initial},
            "fault_injector": {"time_scale": setting.time_scale},
        }
        for node, values in self._scenario.parameters.items():
            given.setdefault(node, {}).update(values)
        if self._scenario.second_controller:
            given[SECOND] = {**given["relay_esc"], "autostart": False}
            for event in self._scenario.events:
                if event.action == SECOND:  # it wants another theta, and nothing else
                    given[SECOND] |= {"theta_initial": event.what, "step_size": 0.0}
        for values in given.values():
            values["listeners"] = "next recorder"
        return given

    def _command(self, name: str) -> tuple[list[str], list[str] | None]:
        setting = self._scenario.setting
        topics = {"state": "rig/state", "theta": "rig/theta"} if self._scenario.injects else {}
        if self._scenario.sensor_topic:
            topics["state"] = self._scenario.sensor_topic
        if self._scenario.command_topic:
            topics["theta"] = self._scenario.command_topic
        if name == "recorder":
            return ["--ros-args", "-p", f"output:={self._folder}"], None
        ros = ["--ros-args", "--params-file", str(self._parameter_file)]
        if name == SECOND:
            return [*ros, "-r", f"__node:={SECOND}"], None
        if name == "fault_injector":
            return ros, [sys.executable, "-m", "koop_hil.fault_injector"]
        if name != "plant":
            return ros, None
        if setting.plant == "vdp_plant":
            remap = [word for name, to in topics.items() for word in ("-r", f"{name}:={to}")]
            return ros + remap, None
        options = {
            "scale": setting.time_scale,
            "theta-initial": setting.theta_initial,
            "readers": 2,  # the recorder and the lifter
            "seed": setting.seed,
            **topics,
        }
        words = [f"--{key}={value}" for key, value in options.items()]
        words += ["--truth", *shlex.split(setting.rig_options)]
        return [setting.plant, "--until-eof", *words], [sys.executable, str(rig_script())]
