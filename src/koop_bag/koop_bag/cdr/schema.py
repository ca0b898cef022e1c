"""Message definitions and type hashes, read from the installed packages' share folders.

A bag must explain itself on a machine where the packages are not installed: it carries the text of
every message definition it needs. The texts and hashes are read as the interface
generators installed them.
"""

import json
import os
import re
import sys
from dataclasses import dataclass
from pathlib import Path

from koop_bag.cdr.definition import message_types
from koop_bag.errors import BagError

SEPARATOR = "=" * 80


@dataclass(frozen=True)
class MessageSchema:
    """A message type as a bag holds it."""

    name: str
    """Full type name, `pkg/msg/Type`."""
    text: str
    """Root definition, then each dependency once after a separator line: those of a message by
    name, each followed by its own, as rosbag2 orders them, so that the texts are equal."""
    type_hash: str
    """`RIHS01_...`, or empty where the package has no type description (readers accept that, but
    not a wrong one)."""
    encoding: str = "ros2msg"
    """Language of the text."""


def load_schema(type_name: str) -> MessageSchema:
    """Find the definition of `pkg/msg/Type` under AMENT_PREFIX_PATH or the Python environment.

    Raises
    ------
    BagError
        If the type or one it depends on is not installed.
    """
    package, separator, name = type_name.replace("/msg/", "/").partition("/")
    if not separator or "/" in name:
        raise BagError(f"'{type_name}' is not a message type: write it as pkg/msg/Type")
    root = _find(package, f"msg/{name}.msg")
    full_name = f"{package}/msg/{name}"
    return MessageSchema(
        full_name,
        _with_dependencies(f"{package}/{name}", _text(root)),
        _type_hash(root.with_suffix(".json"), full_name),
    )


def load_service(type_name: str) -> tuple[str, str]:
    """Find the definitions of request and response of `pkg/srv/Type`; as :func:`load_schema`."""
    package, _, name = type_name.partition("/srv/")
    if not name:
        raise BagError(f"'{type_name}' is not a service type: write it as pkg/srv/Type")
    text = _text(_find(package, f"srv/{name}.srv"))
    request, response = re.split(r"^---[ \t]*$\n?", text, flags=re.MULTILINE)
    root = f"{package}/{name}"
    return _with_dependencies(root, request), _with_dependencies(root, response)


def _with_dependencies(name: str, root: str) -> str:
    """Return the root definition of `pkg/Type` followed by its dependencies."""
    parts = [root]
    included = {name}

    def append_dependencies(text: str, package: str) -> None:
        for name in sorted(set(message_types(text, package))):
            if name in included:
                continue
            included.add(name)
            inside, _, short = name.partition("/")
            definition = _text(_find(inside, f"msg/{short}.msg"))
            parts.append(f"{SEPARATOR}\nMSG: {name}\n{definition}")
            append_dependencies(definition, inside)

    append_dependencies(root, name.partition("/")[0])
    return "\n".join(parts)


def _find(package: str, file: str) -> Path:
    listed = [p for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    for prefix in [*listed, sys.prefix]:
        path = Path(prefix) / "share" / package / file
        if path.is_file():
            return path
    kind = "message" if file.startswith("msg") else "service"
    raise BagError(
        f"no definition of {kind} {package}/{Path(file).with_suffix('')} "
        "under any prefix of AMENT_PREFIX_PATH: "
        f"build or install the package '{package}' and source the workspace"
    )


def _text(path: Path) -> str:
    return path.read_bytes().decode()  # every byte as it lies there


def _type_hash(path: Path, full_name: str) -> str:
    if not path.is_file():
        return ""
    for entry in json.loads(path.read_text(encoding="utf-8")).get("type_hashes", []):
        if entry["type_name"] == full_name:
            return str(entry["hash_string"])
    return ""
