"""Message definitions and type hashes, read from the installed packages' share folders.

A bag must explain itself on a machine where the packages are not installed: it carries the text of
every message definition it needs. The texts and hashes are read as the interface
generators installed them.
"""

import json
import os
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from koop_bag.errors import BagError

SEPARATOR = "=" * 80

_BUILTIN = re.compile(r"(bool|byte|char|float(32|64)|u?int(8|16|32|64)|w?string)$")
_FIELD_TYPE = re.compile(r"^\s*([A-Za-z]\w*(?:/\w+)*)(?:<=\d+)?(?:\[[^\]]*\])?\s+[A-Za-z]\w*")


@dataclass(frozen=True)
class MessageSchema:
    """A message type as a bag holds it.

    Attributes
    ----------
    name : str
        Full type name, `pkg/msg/Type`.
    text : str
        Root definition, then each dependency once after a separator line: those of a message by
        name, each followed by its own, as rosbag2 orders them, so that the texts are equal.
    type_hash : str
        `RIHS01_...`, or empty where the package has no type description (readers accept that, but
        not a wrong one).
    encoding : str
        Language of the text.
    """

    name: str
    text: str
    type_hash: str
    encoding: str = "ros2msg"


def load_schema(type_name: str, prefixes: Sequence[str | Path] | None = None) -> MessageSchema:
    """Find the definition of a message type.

    Parameters
    ----------
    type_name : str
        `pkg/msg/Type`, or `pkg/Type` for short.
    prefixes : sequence of path, optional
        Install prefixes to search in order. Default: `AMENT_PREFIX_PATH`, then the Python
        environment's own.

    Raises
    ------
    BagError
        If the type or one it depends on is not installed.
    """
    package, name = _split(type_name)
    places = _places(prefixes)
    root = _find(places, package, f"msg/{name}.msg")
    full_name = f"{package}/msg/{name}"
    return MessageSchema(
        full_name,
        _with_dependencies(places, package, name, _text(root)),
        _type_hash(root.with_suffix(".json"), full_name),
    )


def load_service(
    type_name: str, prefixes: Sequence[str | Path] | None = None
) -> tuple[MessageSchema, MessageSchema]:
    """Find the definitions of a service type's request and response; as :func:`load_schema`.

    Parameters
    ----------
    type_name : str
        `pkg/srv/Type`.
    """
    package, _, name = type_name.partition("/srv/")
    if not name:
        raise BagError(f"'{type_name}' is not a service type: write it as pkg/srv/Type")
    places = _places(prefixes)
    request, _, response = re.split(
        r"^(---)[ \t]*$\n?", _text(_find(places, package, f"srv/{name}.srv")), flags=re.MULTILINE
    )
    return (
        MessageSchema(
            f"{type_name}_Request", _with_dependencies(places, package, name, request), ""
        ),
        MessageSchema(
            f"{type_name}_Response", _with_dependencies(places, package, name, response), ""
        ),
    )


def _with_dependencies(places: Sequence[Path], package: str, name: str, root: str) -> str:
    """Return a root definition followed by its dependencies."""
    parts = [root]
    included = {(package, name)}

    def append_dependencies(text: str, inside: str) -> None:
        for dependency in sorted(set(_dependencies(text, inside))):
            if dependency in included:
                continue
            included.add(dependency)
            path = _find(places, dependency[0], f"msg/{dependency[1]}.msg")
            dependency_text = _text(path)
            parts.append(f"{SEPARATOR}\nMSG: {'/'.join(dependency)}\n{dependency_text}")
            append_dependencies(dependency_text, dependency[0])

    append_dependencies(root, package)
    return "\n".join(parts)


def _split(type_name: str) -> tuple[str, str]:
    parts = type_name.split("/")
    if len(parts) == 3 and parts[1] == "msg":
        return parts[0], parts[2]
    if len(parts) == 2:
        return parts[0], parts[1]
    raise BagError(f"'{type_name}' is not a message type: write it as pkg/msg/Type")


def _places(prefixes: Sequence[str | Path] | None) -> list[Path]:
    return _prefixes() if prefixes is None else [Path(prefix) for prefix in prefixes]


def _prefixes() -> list[Path]:
    listed = [Path(p) for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    return [*listed, Path(sys.prefix)]


def _find(prefixes: Sequence[Path], package: str, file: str) -> Path:
    for prefix in prefixes:
        path = prefix / "share" / package / file
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


def _dependencies(text: str, inside: str) -> Iterator[tuple[str, str]]:
    for line in text.splitlines():
        match = _FIELD_TYPE.match(line.partition("#")[0])
        if match is None or _BUILTIN.match(match[1]):
            continue
        parts = match[1].split("/")
        if match[1] == "Header":  # the one type that ROS lets stand without its package
            yield "std_msgs", "Header"
        else:
            yield (parts[0] if len(parts) > 1 else inside), parts[-1]


def _type_hash(path: Path, full_name: str) -> str:
    if not path.is_file():
        return ""
    for entry in json.loads(path.read_text(encoding="utf-8")).get("type_hashes", []):
        if entry["type_name"] == full_name:
            return str(entry["hash_string"])
    return ""
