"""A loop as a service: the systemd unit that starts it with the machine, and again if it fails."""

from __future__ import annotations

import os
import pwd
import re
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from koop_bringup.live.process import START_TIMEOUT, STOP_TIMEOUT
from koop_bringup.plan import Plan, return_time
from koop_core.config.parameter import ConfigError

SYSTEM_UNITS = Path("/etc/systemd/system")
WATCHDOG = 30.0  # [s] without a sign of life of the loop after which it is started again
KEPT = ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS", "KOOP_UNDERLAY",
        "FASTDDS_BUILTIN_TRANSPORTS", "ROS_SECURITY_ENABLE", "ROS_SECURITY_KEYSTORE",
        "ROS_SECURITY_STRATEGY")  # fmt: skip
"""Variables of the environment that a loop keeps as a service."""
UNIT = """\
# Written by 'koop up --install'; 'systemctl edit {name}' changes it and survives the next one.
[Unit]
Description=koop: closed loop of {file}
{order}
# Where systemd knows no RestartSteps (before 254), it gives up a loop that fails again and again;
# theta is at theta_safe then.
StartLimitIntervalSec=3600
StartLimitBurst=20

[Service]
Type=notify
ExecStart={command}
WorkingDirectory={cwd}
{environment}
{user}

TimeoutStartSec={start:.0f}
# Each node reports and the step moves on, or a node says why it does not.
WatchdogSec={watchdog:.0f}
WatchdogSignal=SIGTERM
Restart=on-failure
# After the guard, or its twin, has returned theta.
RestartSec={again:.0f}
RestartSteps=8
RestartMaxDelaySec={longest:.0f}
# 1: it ended as it was told to, but went on without its recorder before.
SuccessExitStatus=1

# Only koop up is told to end: it ends the guard first, while the recorder still works. All its
# processes end with it, also if it is killed, each in its own order. Then 'mixed' would kill guard
# and twin, and theta would stay; 'control-group' ends the recorder before theta has returned.
KillMode=process
TimeoutStopSec={stop:.0f}

NoNewPrivileges=yes
ProtectSystem=strict
# Run folders, the note of theta, and compiled kernels.
ReadWritePaths={writable}
PrivateTmp=yes
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6 AF_NETLINK
RestrictNamespaces=yes
RestrictSUIDSGID=yes
LockPersonality=yes
SystemCallArchitectures=native
{privileges}

[Install]
WantedBy={target}
"""
OF_SYSTEM = """\
CapabilityBoundingSet=
ProtectClock=yes
ProtectControlGroups=yes
ProtectHostname=yes
ProtectKernelLogs=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
ProtectProc=invisible"""


def unit_name(label: str) -> str:
    """Return the name of the unit of a loop.

    >>> unit_name("my rig")
    'koop-my-rig.service'
    """
    return f"koop-{re.sub('[^A-Za-z0-9_.-]', '-', label)}.service"


def unit_folder(system: bool) -> Path:
    """Return where the administrator, or the user, keeps units."""
    if system:
        return SYSTEM_UNITS
    return Path(os.environ.get("XDG_CONFIG_HOME") or "~/.config").expanduser() / "systemd/user"


def describe_unit(
    name: str, file: Path, options: Sequence[str], planned: Plan, system: bool
) -> str:
    """Return the text of the unit that calls ``koop up`` with a file, or folder, and options.

    With ``system`` it is the machine's, run as the owner of the file, else its user's.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If it was not started by ``./koop``, or the folder of the guard's note does not exist.
    """
    if not (root := os.environ.get("KOOP_ROOT")):
        raise ConfigError("--install: call it as './koop up', which the service will do, too")
    back = return_time(planned.parameters)
    kept = {name: os.environ[name] for name in KEPT if os.environ.get(name)}
    kept["ROS_LOG_DIR"] = "/tmp/ros"
    folders = [Path("recordings"), Path(root, "src"), Path(root, "ros2_ws/install")]
    if note := planned.parameters.get("koop_guard", {}).get("note"):
        folders.append(Path(note).parent)
        if not folders[-1].is_dir():  # systemd would not start the unit, and not say why
            raise ConfigError(
                f"--install: no folder {folders[-1]}, where koop_guard.note of {file} lies: "
                "make it, or call 'koop tune' where the rig file is now"
            )
    privileges = OF_SYSTEM if system else ""
    if system and not planned.program:  # whose devices nobody here knows
        privileges += "\nPrivateDevices=yes"
    if priority := max(values.get("priority", 0) for values in planned.parameters.values()):
        privileges += f"\nLimitRTPRIO={priority}\nLimitMEMLOCK=infinity"
    again = back + STOP_TIMEOUT
    words = [str(Path(root, "koop")), "up", str(file.resolve()), *options]
    return UNIT.format(
        name=name,
        file=_escape(str(file.resolve())),
        order="Wants=network-online.target\nAfter=network-online.target" if system else "",
        command=" ".join(_quote(word).replace("$", "$$") for word in words),
        cwd=_escape(str(Path.cwd())),
        environment="\n".join(f"Environment={_quote(f'{k}={v}')}" for k, v in kept.items()),
        user=f"User={pwd.getpwuid(file.stat().st_uid).pw_name}" if system else "",
        start=2.0 * START_TIMEOUT,
        watchdog=WATCHDOG + 20.0 * _period(planned),
        again=again,
        longest=max(300.0, again),
        stop=2.0 * (back + STOP_TIMEOUT) + STOP_TIMEOUT * (len(planned.nodes) + 2),
        writable=" ".join(_quote(str(folder.resolve())) for folder in folders),
        privileges=privileges.strip(),
        target="multi-user.target" if system else "default.target",
    )


def describe_commands(name: str, file: Path, system: bool) -> str:
    """Return what is to be typed next."""
    user = "" if system else " --user"
    lines = [f"systemctl{user} daemon-reload", f"systemctl{user} enable --now {name}"]
    lines += [] if system else ["loginctl enable-linger   # it runs while nobody is logged in"]
    lines += [f"journalctl{user} -u {name} -f", f"./koop status {shlex.quote(str(file))}"]
    return "\n".join(f"  {line}" for line in lines)


def _period(planned: Plan) -> float:
    """Return the time between two steps by the clock on the wall [s]."""
    values: Mapping[str, Any] = planned.parameters.get("koop_guard", {})
    return float(values.get("dt", 0.0)) / float(values.get("pace", 1.0))


def _escape(text: str) -> str:
    return text.replace("%", "%%")


def _quote(text: str) -> str:
    return '"' + _escape(text).replace("\\", "\\\\").replace('"', '\\"') + '"'
