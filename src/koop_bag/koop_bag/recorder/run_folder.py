"""The folder of a run: what is needed, besides the messages, to do the same again."""

from __future__ import annotations

import hashlib
import platform
import secrets
import subprocess
import time
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from koop_bag.bag.metadata import dump
from koop_bag.errors import BagWriteError, writing

_DISTRIBUTIONS = (
    "numpy", "numba", "scipy", "mcap", "rclpy", "koop_msgs", "koop_core", "koop_node", "koop_bag",
    "vdp_plant", "koopman_lifter", "relay_esc",
)  # fmt: skip


def default_folder(label: str) -> Path:
    """Return the folder of a new run under recordings/, named after the time."""
    return Path("recordings") / f"{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime())}-{label}"


def make_run_folder(output: str) -> Path:
    """Return the folder of a new run, created: `output`, or one named after the time.

    Raises
    ------
    BagWriteError
        If it cannot be created or holds a recording already.
    """
    # The suffix keeps apart two recorders that are started in the same second.
    folder = Path(output).expanduser() if output else default_folder(secrets.token_hex(2))
    if (folder / "bag").exists():
        raise BagWriteError(f"{folder} holds a recording already: choose another output")
    with writing(f"create the folder {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
    return folder.resolve()


def parameter_text(nodes: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the parameters of all nodes as a ROS 2 parameter file.

    An empty list is left out: ROS 2 cannot read it back, for it does not show its type.
    """
    content = {
        node: {"ros__parameters": {name: value for name, value in values.items() if value != []}}
        for node, values in sorted(nodes.items())
    }
    return dump(content)


def write_parameters(folder: Path, nodes: Mapping[str, Mapping[str, Any]]) -> None:
    """Write `parameters.yaml`, to be given to nodes as `--params-file`."""
    _write(folder / "parameters.yaml", parameter_text(nodes))


def write_versions(folder: Path) -> dict[str, str]:
    """Write `versions.yaml`: software and machine of this process; return its content."""
    versions = {
        "python": platform.python_version(),
        "os": platform.platform(),
        "machine": platform.machine(),
        "git_revision": git_revision(Path(__file__).resolve().parent),
    }
    for name in _DISTRIBUTIONS:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            continue
    _write(folder / "versions.yaml", dump(versions))
    return versions


def git_revision(where: Path) -> str:
    """Return the commit of the work tree that holds `where`, `-dirty` if changed, or ''."""
    git = ["git", "--no-optional-locks", "-C", str(where)]  # a kill would leave a lock behind
    try:
        revision, changes = (
            subprocess.run(
                [*git, *words], capture_output=True, text=True, timeout=5.0, check=False
            ).stdout.strip()
            for words in (["describe", "--always", "--abbrev=40"], ["status", "--short", "-uno"])
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return f"{revision}-dirty" if changes else revision


def keep_model(folder: Path, nodes: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """Copy the file that a node's parameter `model` names into `model/`; return SHA-256 by name.

    Another file of the same name, from another folder or of another time, is kept beside it; what
    is not a readable local file is left out.
    """
    kept: dict[str, str] = {}
    for values in nodes.values():
        try:
            path = Path(str(values.get("model") or "")).expanduser()
            if not path.is_file():
                continue
            content = path.read_bytes()
        except (OSError, RuntimeError):  # too long a name, a user whom there is not
            continue
        digest = hashlib.sha256(content).hexdigest()
        target = folder / "model" / path.name
        with writing(f"keep the model {path}"):
            target.parent.mkdir(exist_ok=True)
            if target.is_file() and target.read_bytes() != content:
                target = target.with_name(f"{path.stem}-{digest[:12]}{path.suffix}")
            target.write_bytes(content)
            kept[target.name] = digest
    return kept


def _write(path: Path, text: str) -> None:
    with writing(f"write {path}"):
        path.write_text(text, encoding="utf-8")
