"""Which parameters were meant for one node, and which for all. Pure: imports nothing of ROS."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any


def shared_names(args: Sequence[str]) -> set[str]:
    """Return the parameters that are given to all nodes of a wildcard only, and to none by name.

    A file for several nodes may hold under ``/**`` what only some of them know.

    Parameters
    ----------
    args : sequence of str
        Command line: ``--params-file FILE`` and ``-p NAME:=VALUE`` between ``--ros-args`` and
        ``--`` count.
    """
    shared: set[str] = set()
    named: set[str] = set()
    for option, value in _ros_options(args):
        if option == "--params-file":
            for section, name in _given(value):
                (shared if section.rpartition("/")[2] in ("*", "**") else named).add(name)
        elif option in ("-p", "--param"):
            named.add(value.partition(":=")[0].rpartition(":")[2])
    return shared - named


def _ros_options(args: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield each word of the ROS arguments with the word after it."""
    ros = False
    for word, following in zip(args, [*args[1:], ""], strict=False):
        if word == "--ros-args":
            ros = True
        elif word == "--":
            ros = False
        elif ros:
            yield word, following


def _given(path: str) -> Iterator[tuple[str, str]]:
    """Yield section and name of every parameter in a file; none if it cannot be read."""
    import yaml  # quick, but only needed where something is wrong

    try:
        content = yaml.safe_load(Path(path).read_text())
    except (OSError, ValueError, yaml.YAMLError):
        return
    yield from _sections(content, "")


def _sections(content: Any, path: str) -> Iterator[tuple[str, str]]:
    for key, value in content.items() if isinstance(content, Mapping) else ():
        if key == "ros__parameters":
            for name in _names(value):
                yield path, name
        else:
            yield from _sections(value, f"{path}/{key}")


def _names(values: Any, prefix: str = "") -> Iterator[str]:
    for key, value in values.items() if isinstance(values, Mapping) else ():
        if isinstance(value, Mapping):
            yield from _names(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}"
