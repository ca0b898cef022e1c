"""Reads ROS 2 parameter files as the nodes read them. Pure: imports nothing of ROS.

A command that reads a file itself can check it before a node is started, and say which of its
values count. rcl's rules hold: a key is the full name of a node, in which ``*`` stands
for one part and ``**`` for any number of them; what comes later in the file wins.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from koop_core.config.parameter import SIMILAR, ConfigError
from koop_core.config.yaml_file import parse_yaml, read_settings

# What every node has, whatever it is: it says nothing about the loop.
ROS_OWN = ("use_sim_time", "start_type_description_service", "qos_overrides")


class NodeSection(NamedTuple):
    """The parameters of the nodes that one key of the file names."""

    key: str
    values: dict[str, Any]

    @property
    def node(self) -> str:
        """The node's own name, ``*`` or ``**``."""
        return self.key.rsplit("/", 1)[-1]

    @property
    def namespace(self) -> str:
        """The namespace of the node, such as ``/rig``; ``/`` is the root."""
        return self.key.rsplit("/", 1)[0] or "/"

    @property
    def for_any(self) -> bool:
        """Whether it is for nodes of any name."""
        return self.node in ("*", "**")

    def names(self, node: str) -> bool:
        """Return whether the key stands for a node, given by its full name."""
        parts = (
            {"**": "(/[^/]+)*", "*": "/[^/]+"}.get(part, "/" + re.escape(part))
            for part in self.key.split("/")[1:]
        )
        return re.fullmatch("".join(parts), node) is not None


@dataclass(frozen=True)
class ParameterFile:
    """The content of a parameter file."""

    path: Path
    sections: tuple[NodeSection, ...]

    def describes(self, node: str) -> bool:
        """Return whether a section is for a node of this full name, not for any."""
        return any(section.names(node) and not section.for_any for section in self.sections)

    def values(self, node: str, allowed: Collection[str]) -> dict[str, Any]:
        """Return what the file says to a node, by its full name.

        From a section for nodes of any name, only ``allowed`` parameters are taken.
        """
        return {
            name: value
            for section in self.sections
            if section.names(node)
            for name, value in section.values.items()
            if not section.for_any or name in allowed or name.startswith(ROS_OWN)
        }

    def values_of(
        self, nodes: Mapping[str, Collection[str]], namespace: str | None = None
    ) -> dict[str, dict[str, Any]]:
        """Return what the file says to nodes, by their own names with the parameters they know.

        The namespace is by default the one that the file names.

        Raises
        ------
        ConfigError
            If the file has no parameters for any of them, names one in another namespace only, or
            has a section with nearly the name of one.
        """
        base = (self.namespace_of(nodes) if namespace is None else namespace).rstrip("/")
        merged = {node: self.values(f"{base}/{node}", names) for node, names in nodes.items()}
        named = [section for section in self.sections if section.node in nodes]
        if not any(merged.values()) or (
            named and not any(section.names(f"{base}/{section.node}") for section in named)
        ):
            keys = ", ".join(section.key for section in self.sections) or "no section"
            wanted = ", ".join(f"{base}/{node}" for node in nodes)
            raise ConfigError(
                f"{self.path}: has no parameters for {wanted}; it has {keys}; "
                "'/**/NAME' is in every one"
            )
        for node in nodes:
            self.refuse_nearly(f"{base}/{node}", nodes)
        return merged

    def refuse_nearly(self, node: str, others: Collection[str] = ()) -> None:
        """Raise ConfigError on a section that must have been meant for a node, and is not its.

        It has the node's name, but another namespace, or nearly its name and none of the others'.
        """
        if self.describes(node):
            return
        name = node.rpartition("/")[2]
        for section in self.sections:
            if section.node == name:
                raise ConfigError(
                    f"{self.path}: '{section.key}' is not {node}: write '{node}', or '/**/{name}' "
                    "for every namespace"
                )
            likeness = difflib.SequenceMatcher(None, section.node, name).ratio()
            if likeness >= SIMILAR and section.node not in others:
                meant = f"{section.key.removesuffix(section.node)}{name}"
                raise ConfigError(
                    f"{self.path}: section '{section.key}' is not of a node of the loop: "
                    f"did you mean '{meant}'?"
                )

    def namespace_of(self, nodes: Collection[str]) -> str:
        """Return the namespace that the file has these nodes in; ``/`` if it names none.

        Raises ConfigError if there are several.
        """
        spaces = {section.namespace for section in self.sections if section.node in nodes}
        named = sorted(space for space in spaces if "*" not in space)
        if len(named) > 1:
            raise ConfigError(
                f"{self.path}: describes several loops, in the namespaces {', '.join(named)}: "
                "keep the sections of one"
            )
        return named[0] if named else "/"


def read(path: str | Path) -> ParameterFile:
    """Read a parameter file.

    Raises
    ------
    ConfigError
        If it cannot be read, is none, or was cut off: what begins with ``---``, as :func:`write`
        begins it, must end with ``...``, or a loop would start without the guard at its end.
    """
    text = read_settings(path)
    content = parse_yaml(text, path, _Loader)
    if text.startswith("---\n") and not text.rstrip().endswith("\n..."):
        raise ConfigError(
            f"{path}: is cut off: it begins with '---' and does not end with '...'; restore it"
        )
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: is not a ROS 2 parameter file")
    return ParameterFile(Path(path), tuple(_sections(str(path), "", content)))


def write(values: Mapping[str, Mapping[str, Any]], path: str | Path) -> None:
    """Write values by node, of any namespace, as a parameter file."""
    content = {
        f"/**/{node}": {"ros__parameters": dict(section)} for node, section in values.items()
    }
    text = yaml.dump(
        content, Dumper=_Dumper, sort_keys=False, explicit_start=True, explicit_end=True
    )
    Path(path).write_text(text, encoding="utf-8")


def as_yaml(value: Any) -> str:
    """Return a value as ROS reads it back, of the same type."""
    plain = list(value) if isinstance(value, tuple) else value
    text = yaml.dump(plain, Dumper=_Dumper, default_flow_style=True, width=math.inf)
    return text.removesuffix("...\n").strip()


def shared_names(args: Sequence[str], node: str) -> set[str]:
    """Return the parameters that files give to nodes of any name only, and nobody to one by name.

    A file for several nodes may hold under ``/**`` what only some of them know. Of the command line
    count ``--params-file FILE`` and ``-p NAME:=VALUE`` between ``--ros-args`` and ``--``; ``node``
    is the full name of the one that reads it.

    Raises
    ------
    ConfigError
        If a file has no section for the node, but one that must have been meant for it, which ROS
        ignores without a word.
    """
    shared: set[str] = set()
    named: set[str] = set()
    for option, value in _ros_options(args):
        if option == "--params-file":
            file = _read_once(value, Path(value).stat().st_mtime_ns)
            file.refuse_nearly(node)
            for section in file.sections:
                (shared if section.for_any else named).update(section.values)
        elif option in ("-p", "--param"):
            named.add(value.partition(":=")[0].rpartition(":")[2])
    return shared - named


@cache
def _read_once(path: str, changed: int) -> ParameterFile:
    """Read a file for all nodes of a process."""
    return read(path)


def _ros_options(args: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield each word of the ROS arguments with the word after it."""
    ros = False
    for word, following in zip(args, [*args[1:], ""], strict=False):
        if word in ("--ros-args", "--"):
            ros = word == "--ros-args"
        elif ros:
            yield word, following


def _sections(path: str, above: str, content: dict[Any, Any]) -> Iterator[NodeSection]:
    """Yield the sections; the keys may be nested, one level a namespace."""
    for key, section in content.items():
        name = f"{above}/{str(key).strip('/')}"
        if not isinstance(section, dict):
            raise ConfigError(f"{path}: '{name}' has no ros__parameters")
        if "ros__parameters" not in section:
            yield from _sections(path, name, section)
        elif isinstance(section["ros__parameters"], dict):
            yield NodeSection(name, dict(_flat("", section["ros__parameters"])))
        else:
            raise ConfigError(f"{path}: ros__parameters of '{name}' is not a mapping")


def _flat(above: str, content: dict[Any, Any]) -> Iterator[tuple[str, Any]]:
    for key, value in content.items():
        if isinstance(value, dict):
            yield from _flat(f"{above}{key}.", value)
        else:
            yield f"{above}{key}", value


class _Loader(yaml.SafeLoader):
    """Takes the same words for numbers as rcl: 1e-3 is one, 1_000, 1:30 and a date are not."""

    yaml_implicit_resolvers: dict[Any, Any] = {}  # noqa: RUF012 - PyYAML's own attribute
    bool_values = {**yaml.SafeLoader.bool_values, "y": True, "n": False}  # noqa: RUF012

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Take a key as it is written, for `y` is a name; of one that comes again, all counts."""
        merged: dict[Any, Any] = {}
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise yaml.constructor.ConstructorError(None, None, "a key is not a name")
            _merge(merged, {key.value: self.construct_object(value, deep=True)})
        return merged


def _merge(merged: dict[Any, Any], more: dict[Any, Any]) -> None:
    for key, value in more.items():
        if isinstance(value, dict) and isinstance(merged.get(key), dict):
            _merge(merged[key], value)
        else:
            merged[key] = value


class _Dumper(yaml.SafeDumper):
    """Quotes a text that rcl would take for a number, such as 1e3; repeats equal lists."""

    def ignore_aliases(self, data: Any) -> bool:
        return True  # rcl refuses them


_WORDS = "|".join(form for word in ("y", "yes", "true", "on", "n", "no", "false", "off")
                  for form in (word, word.capitalize(), word.upper()))  # fmt: skip
_REAL = r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?"
for _tag, _pattern in (
    ("bool", _WORDS),
    ("int", "[-+]?(0x[0-9a-fA-F]+|0[0-7]*|[1-9][0-9]*)"),
    ("float", rf"{_REAL}|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"),
    ("null", "null|Null|NULL|~|"),
):
    for _yaml in (_Loader, _Dumper):
        _yaml.add_implicit_resolver(
            f"tag:yaml.org,2002:{_tag}", re.compile(f"(?:{_pattern})$"), None
        )
