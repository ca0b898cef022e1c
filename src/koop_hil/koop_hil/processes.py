"""The processes of a scenario: started, killed, paused, started again, and none left behind."""

from __future__ import annotations

import shlex
import shutil
import signal
import sys
from pathlib import Path

from koop_bringup.live.monitor import Monitor
from koop_bringup.live.process import NodeProcess
from koop_core.config import parameter_file
from koop_core.errors import LiveError
from koop_hil import installed
from koop_hil.hosts import OtherHost
from koop_hil.scenario import Scenario


class Processes:
    """The nodes of one scenario run in a folder; a context manager.

    ``monitor`` is the run's client in the ROS domain; ``other_host`` is where the scenario's remote
    process runs.
    """

    def __init__(
        self, folder: Path, scenario: Scenario, monitor: Monitor, other_host: OtherHost | None
    ) -> None:
        self.monitor = monitor
        self.logs = folder / "logs"
        self.failures: list[str] = []  # of those that were stopped
        self._scenario = scenario
        self._other_host = other_host
        self._running: dict[str, NodeProcess] = {}
        self._parameter_file = self.logs / "given_parameters.yaml"
        self._order = [
            "recorder",  # listeners first
            "relay_esc",
            "koopman_lifter",
            *(["fault_injector"] if scenario.injects else []),
            "plant",
        ]

    def __enter__(self) -> Processes:
        self.logs.mkdir(parents=True, exist_ok=True)
        parameter_file.write(self._parameters(), self._parameter_file)
        try:
            for name in self._order:
                self.start(name)
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def start(self, name: str) -> None:
        """Start a process of the scenario."""
        arguments, command = self._command(name)
        node = "vdp_plant" if name == "plant" and not command else name
        remote = self._other_host is not None and name == self._scenario.setting.remote
        before = tuple(self._other_host.words) if remote and self._other_host else ()
        log = self.logs / f"{name}.log"
        self._running[name] = NodeProcess(node, arguments, log, command, before=before)

    def kill(self, name: str) -> None:
        """End a process as a power cut would."""
        process = self._running.pop(name)
        process.process.kill()
        process.stop()

    def pause(self, name: str, paused: bool) -> None:
        """Stop a process with SIGSTOP, or let it go on."""
        self._running[name].process.send_signal(signal.SIGSTOP if paused else signal.SIGCONT)

    def link(self, up: bool) -> None:
        """Cut the link to the other host, or mend it."""
        assert self._other_host is not None  # the scenario would have been refused
        self._other_host.link(up)

    def dead(self) -> list[str]:
        """Return how processes ended that ended on their own, with their last lines."""
        return [str(p.failure()) for p in self._running.values() if p.poll() is not None]

    def refuse_dead(self) -> None:
        """Raise LiveError if a process ended on its own."""
        for failure in self.dead():
            raise LiveError(failure)

    def close(self) -> None:
        """Stop all, the sources before the recorder."""
        for name in reversed(self._order):
            if name in self._running:
                process = self._running.pop(name)
                process.process.send_signal(signal.SIGCONT)
                if process.stop() != 0:
                    self.failures.append(str(process.failure()))

    def _parameters(self) -> dict[str, dict[str, object]]:
        setting = self._scenario.setting
        nodes: dict[str, dict[str, object]] = {
            "vdp_plant": {
                "pace": "scaled",
                "time_scale": setting.time_scale,
                "theta_initial": setting.theta_initial,
            },
            "koopman_lifter": {"model": self._copy_model()} if setting.model else {},
            "relay_esc": {"theta_initial": setting.theta_initial},
            "fault_injector": {"time_scale": setting.time_scale},
        }
        for node, values in self._scenario.parameters.items():
            nodes.setdefault(node, {}).update(values)
        for values in nodes.values():
            values["listeners"] = "next recorder"
        return nodes

    def _copy_model(self) -> str:
        """Copy the model to the run: a better one is written beside it."""
        return str(Path(shutil.copy(self._scenario.setting.model, self.logs)).absolute())

    def _command(self, name: str) -> tuple[list[str], list[str] | None]:
        """Return the arguments of a process, and its program if it is not a node's executable."""
        ros = ["--ros-args", "--params-file", str(self._parameter_file)]
        match name:
            case "recorder":
                return ["--ros-args", "-p", f"output:={self.logs.parent}"], None
            case "fault_injector":
                return ros, [sys.executable, "-m", "koop_hil.fault_injector"]
            case "plant":
                return self._plant(ros)
        return ros, None

    def _plant(self, ros: list[str]) -> tuple[list[str], list[str] | None]:
        scenario, setting = self._scenario, self._scenario.setting
        topics = {"theta": "theta"}
        if scenario.injects:
            topics = {"state": "rig/state", "theta": "rig/theta"}
        if scenario.sensor_topic:
            topics["state"] = scenario.sensor_topic
        if setting.plant == "vdp_plant":
            return [*ros, *(w for t, to in topics.items() for w in ("-r", f"{t}:={to}"))], None
        options = {
            "scale": setting.time_scale,
            "readers": 2,  # the recorder and the lifter
            **topics,
        }
        words = [f"--{key}={value}" for key, value in options.items()]
        words += ["--theta-initial", *map(str, setting.each("theta_initial"))]
        words += ["--truth", *shlex.split(setting.rig_options)]
        program = [sys.executable, str(installed("rigs") / "rig.py")]
        return [setting.plant, "--until-eof", *words], program
