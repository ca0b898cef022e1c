"""Health of a running loop, and its status in a few lines."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

from koop_bringup.live.monitor import Progress
from koop_core.config.knobs import format_knobs
from koop_core.config.parameter import Settings, parameter
from koop_core.stream.report import WARN
from koop_guard.config import GuardConfig


@dataclass(frozen=True)
class HealthSettings(Settings):
    """When a running loop is healthy."""

    silent: float = parameter(
        10.0, "without a report of a node", unit="s", low=1.0, origin="it reports once a second"
    )
    guard_silent: float = parameter(
        3.0, "the same of the guard, on whose commands the rig depends", unit="s", low=1.0,
        origin="it reports once a second; its twin ends one that stood still for 8 s",
    )  # fmt: skip


HEALTH = HealthSettings()


def judge_health(
    progress: Progress, nodes: Collection[str], lost: Collection[str], now: float
) -> list[str]:
    """Return in words why a loop is not healthy; empty if it is.

    Parameters
    ----------
    progress : Progress
        What its nodes report.
    nodes, lost : collection of str
        Nodes that were started, and the ones among them that have ended.
    now : float
        Steady time [s].
    """
    faults = [f"{node} has ended" for node in lost]
    for node in nodes:
        if node not in lost and (age := _old(progress, node, now)):
            faults.append(f"{node} is silent" + f" for {age:.0f} s" * math.isfinite(age))
    guard = progress.values.get("koop_guard", {})
    for node, text in progress.told.items():
        if node not in nodes:  # of others, as of the rig's own driver
            continue
        of_guard = node == "koop_guard" and guard.get("status") != "following"
        if of_guard or progress.levels[node] > WARN:
            faults.append(text)
    return faults


def _old(progress: Progress, node: str, now: float) -> float:
    """Return the age of the last report of a node [s] if that is too old; else 0."""
    age = now - progress.heard.get(node, -math.inf)
    return age if age > (HEALTH.guard_silent if node == "koop_guard" else HEALTH.silent) else 0.0


def describe_loop(
    progress: Progress,
    faults: Collection[str],
    values: Mapping[str, Mapping[str, Any]],
    folder: Path,
    recorded: bool,
    running: float,
    now: float,
) -> str:
    """Return the status of a loop: health, warnings, theta, rig, folder, recording and time.

    Parameters
    ----------
    faults
        Of :func:`judge_health`.
    values : mapping
        Parameters by node.
    recorded : bool
        Whether its recorder runs.
    running : float
        Time since its start [s].
    now : float
        Steady time [s].
    """
    guard = values.get("koop_guard")
    status = progress.values.get("koop_guard", {}).get("status", "not heard yet")
    rig = f"measured {values.get('koopman_lifter', {}).get('measured', 'state')}"
    if guard is not None:
        rig = f"measured {guard.get('measured', GuardConfig.measured)}, command {guard['command']}"
    elif "vdp_plant" in values:
        rig = "the simulated plant"
    theta = format_knobs(progress.theta)
    teller = "koop_guard" if guard is not None else "relay_esc"
    age = _old(progress, "vdp_plant" if "vdp_plant" in values else teller, now)
    was = f", {age:.0f} s ago" * (0.0 < age < math.inf)
    others = [
        text for node, text in progress.told.items()
        if node not in values and progress.levels[node] > WARN
    ]  # fmt: skip
    warnings = [
        f"  {text}" for node, text in progress.told.items()
        if node in values and progress.levels[node] == WARN and text not in faults
    ]  # fmt: skip
    size = 0
    for file in (folder / "bag").glob("*"):
        with suppress(FileNotFoundError):  # the recorder drops the oldest
            size += file.stat().st_size
    return "\n".join(
        [
            "  " + ("not healthy: " + "; ".join(faults) if faults else "healthy"),
            *warnings,
            ("  theta is not commanded yet" if status == "waiting" else f"  theta = {theta}")
            + f", guard {status}" * (guard is not None)
            + was,
            f"  rig: {rig}",
            f"  run: {folder.resolve()}, "
            + (f"recording, {size / 1e6:.1f} MB" if recorded else "not recording"),
            f"  running for {timedelta(seconds=int(running))}, step {progress.step}",
            *[f"  not of this loop, on /diagnostics: {'; '.join(others)}"] * bool(others),
        ]
    )
