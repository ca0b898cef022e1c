"""``koop up``: the loop of a rig as its parameter file describes it, without ROS 2's own tools."""

from __future__ import annotations

import argparse
import math
import os
import shutil
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from koop_bag.recorder.run_folder import default_folder
from koop_bringup.live.loop import LiveNodes
from koop_bringup.live.memory import Memory
from koop_bringup.live.monitor import Progress
from koop_bringup.live.served import add_serve_option, served
from koop_bringup.plan import ALL_NODES, Plan, plan
from koop_bringup.service import describe_commands, describe_unit, unit_folder, unit_name
from koop_core.config import parameter_file
from koop_core.config.knobs import format_knobs
from koop_core.config.parameter import ConfigError
from koop_core.errors import KoopError
from koop_lab.recorded.report import describe, read
from koop_tune.folder import find_controller

STATUS = 10.0  # [s] between two status lines when nothing new is to be said
LASTING = 60.0  # [s] for which a level that a node had is not new


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser(
        "up",
        description="Starts lifter, controller, guard and recorder with the parameters of a file, "
        "and the simulated plant or the rig's own program if the file has a section vdp_plant or "
        "rig.command; watches them and ends them together. Ctrl-C ends the run. The file is that "
        "of 'ros2 launch koop_bringup closed_loop.launch.py params:=FILE record:=true', which "
        "starts the same; 'koop params' writes one.",
    )
    parser.add_argument(
        "file", metavar="FILE", type=Path,
        help="ROS 2 parameter file, or folder of 'koop tune' or 'koop commission'",
    )  # fmt: skip
    parser.add_argument(
        "--out", metavar="DIR", help="folder of the run (default: recordings/TIME-NAME)"
    )
    parser.add_argument(
        "--composed",
        action="store_true",
        help="all nodes but recorder and guard share one process: a step takes a third of the time",
    )
    parser.add_argument(
        "--install",
        action="store_true",
        help="start nothing: write a systemd unit that does, with these options, with the machine "
        "(root) or for this user; print the commands",
    )
    add_serve_option(parser)
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 1 if the run went on without its recorder."""
    planned, folder = read_options(args)
    if args.install:
        return install(args, planned)
    memory = Memory(planned)
    recalled, remark = memory.recall()
    for node, values in recalled.items():
        planned.parameters[node] |= values
    for note in [*planned.notes, *([remark] if remark else [])]:
        print(f"note: {note}")
    started = ", ".join([node.name for node in planned.nodes] + ["rig"] * bool(planned.program))
    print(f"starting {started}; logs in {folder}/logs; Ctrl-C ends the run", flush=True)
    status = StatusLine([node.name for node in planned.nodes])

    def show(progress: Progress) -> None:
        status.show(progress)
        memory.keep(progress)

    nodes = LiveNodes(folder, planned)
    nodes.file = find_controller(args.file)[0]
    try:
        with nodes, served(args.serve, folder / "logs"):
            try:
                nodes.run(show)
            except KeyboardInterrupt:
                guarded = "koop_guard" in planned.parameters
                print("\nending" + ": theta is left to the guard" * guarded, flush=True)
                nodes.end()
    finally:
        if (folder / "bag").is_dir():
            print(f"recording in {folder}/bag, parameters in {folder}/parameters.yaml", flush=True)
    try:
        print("\n" + describe(read(folder, namespace=planned.namespace or "/")))
    except KoopError as error:
        print(f"no figures of the run: {error}")
    return 1 if nodes.lost else 0


def install(args: argparse.Namespace, planned: Plan) -> int:
    """Write the unit of a service, and say how it is started; return the exit code."""
    if args.out:
        raise ConfigError("--install: without --out, each start has a run folder of its own")
    system = os.geteuid() == 0
    name = unit_name(find_controller(args.file)[1])
    options = ["--composed"] * args.composed
    options += [] if args.serve is None else [f"--serve={args.serve}"]
    text = describe_unit(name, args.file, options, planned, system)
    if not (recordings := Path("recordings")).is_dir():
        recordings.mkdir()
        if system:  # the service runs as the owner of the file
            shutil.chown(recordings, args.file.stat().st_uid, args.file.stat().st_gid)
    unit = unit_folder(system) / name
    unit.parent.mkdir(parents=True, exist_ok=True)
    unit.write_text(text)
    print(f"written: {unit}; next:\n{describe_commands(name, args.file, system)}")
    return 0


def read_options(args: argparse.Namespace) -> tuple[Plan, Path]:
    """Return what is started, and the folder of the run.

    Raises
    ------
    KoopError
        If the file or an option cannot be used.
    """
    file, label = find_controller(args.file)
    planned = plan(
        {
            "params": str(file),
            "record": "true",
            "output": args.out or "",
            "composed": "true" if args.composed else "false",
            "namespace": parameter_file.read(file).namespace_of(ALL_NODES),
        }
    )
    recorder = planned.parameters["recorder"]
    folder = Path(recorder.get("output") or default_folder(label)).expanduser()
    recorder["output"] = str(folder)
    return planned, folder


class StatusLine:
    """Prints where the run is: when a node gets a level that it lacked, and every now and then."""

    def __init__(self, nodes: Sequence[str]) -> None:
        self._nodes = nodes
        self._said: object = None
        self._seen: dict[str, float] = {}  # when a node was last said to have a level [s]
        self._time = -math.inf

    def show(self, progress: Progress) -> None:
        """Print a line if it is time."""
        now = time.monotonic()
        levels = [text.partition(":")[0] for text in progress.findings.values()]
        silent = [node for node in self._nodes if node not in progress.heard]
        refused = progress.values.get("koop_guard", {}).get("rearm_refused", "")
        news = (bool(progress.values), progress.step > 0, silent, bool(refused))
        is_new = any(now > self._seen.get(level, -math.inf) + LASTING for level in levels)
        if now < self._time + (1.0 if is_new or news != self._said else STATUS):
            return
        self._said, self._time = news, now
        self._seen |= dict.fromkeys(levels, now)
        findings = list(progress.told.values())
        if silent and progress.values:
            findings.append(f"{', '.join(silent)}: starting, which after an update takes a minute")
        level = "; ".join(findings)
        where = ""
        if progress.step:
            words = [f"step {progress.step}"]
            words += [f"r = {progress.r:.3g}"] * math.isfinite(progress.r)
            words += [f"θ = {format_knobs(progress.theta, '+.3f')}"] * bool(progress.theta)
            where = f"{', '.join(words)}, {progress.steps_per_second:.0f} steps/s: "
            level = level or "ok"
        elif progress.values:
            level = level or "waiting for the first state"
        print(f"{time.strftime('%H:%M:%S')} {where}{level or 'connecting'}", flush=True)
