"""Reads ROS 2 parameter files as the nodes read them. Pure: imports nothing of ROS.

A command that reads a file itself can check it before a node is started, and say which of its
values count. The rules are those of rcl: a key is the full name of a node, in which ``*`` stands
for one part and ``**`` for any number of them; what comes later in the file wins.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from koop_core.config.parameter import ConfigError
from koop_core.config.yaml_file import read_yaml

# What every node has, whatever it is: it says nothing about the loop.
ROS_OWN = ("use_sim_time", "start_type_description_service", "qos_overrides")


SIMILAR = 0.7  # of two names, from 0 to 1, from which on one is taken for the other misspelt


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

    def values(self, node: str, known: Collection[str]) -> dict[str, Any]:
        """Return what the file says to a node.

        Parameters
        ----------
        node : str
            Full name, such as ``/rig/relay_esc``.
        known : collection of str
            The node's parameters; of a section for nodes of any name, only these are taken.
        """
        found: dict[str, Any] = {}
        for section in self.sections:
            if section.names(node):
                found.update(
                    (name, value)
                    for name, value in section.values.items()
                    if not section.for_any or name in known or name.startswith(ROS_OWN)
                )
        return found

    def values_of(
        self, known: Mapping[str, Collection[str]], namespace: str | None = None
    ) -> dict[str, dict[str, Any]]:
        """Return what the file says to the nodes of a namespace, by their own names.

        Parameters
        ----------
        known : mapping of str to collection of str
            The parameters of each node.
        namespace : str, optional
            By default the one that the file names.

        Raises
        ------
        ConfigError
            If the file has no parameters for any of them, names one in another namespace only, or
            has a section whose name is nearly that of one.
        """
        base = (self.namespace_of(known) if namespace is None else namespace).rstrip("/")
        found = {node: self.values(f"{base}/{node}", names) for node, names in known.items()}
        named = [section for section in self.sections if section.node in known]
        if not any(found.values()) or (
            named and not any(section.names(f"{base}/{section.node}") for section in named)
        ):
            keys = ", ".join(section.key for section in self.sections) or "no section"
            wanted = ", ".join(f"{base}/{node}" for node in known)
            raise ConfigError(
                f"{self.path}: has no parameters for {wanted}; it has {keys}; "
                "'/**/NAME' is in every one"
            )
        self._refuse_misspelt(known)
        for section in named:
            node = f"{base}/{section.node}"
            if not self.describes(node):
                raise ConfigError(
                    f"{self.path}: '{section.key}' is not in the loop's namespace {base or '/'}: "
                    f"write '{node}', or '/**/{section.node}' for every namespace"
                )
        return found

    def _refuse_misspelt(self, nodes: Collection[str]) -> None:
        """Raise ConfigError on a section whose name is nearly that of a node."""
        for section in self.sections:
            near = difflib.get_close_matches(section.node, nodes, n=1, cutoff=SIMILAR)
            if near and section.node not in nodes:
                meant = f"{section.key.removesuffix(section.node)}{near[0]}"
                raise ConfigError(
                    f"{self.path}: section '{section.key}' is not one of a node of the loop: "
                    f"did you mean '{meant}'?"
                )

    def namespace_of(self, nodes: Collection[str]) -> str:
        """Return the one namespace that the file has these nodes in; ``/`` if it names none.

        Raises
        ------
        ConfigError
            If it is not one.
        """
        found = sorted(
            {
                section.namespace
                for section in self.sections
                if section.node in nodes and "*" not in section.namespace
            }
        )
        if len(found) > 1:
            raise ConfigError(
                f"{self.path}: describes several loops, in the namespaces {', '.join(found)}: "
                "keep the sections of one"
            )
        return found[0] if found else "/"


def read(path: str | Path) -> ParameterFile:
    """Read a parameter file.

    Raises
    ------
    ConfigError
        If it cannot be read or is not a parameter file.
    """
    content = read_yaml(path, _Loader)
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: is not a ROS 2 parameter file")
    return ParameterFile(Path(path), tuple(_sections(str(path), "", content)))


def refuse_unused_sections(args: Sequence[str], nodes: Collection[str]) -> None:
    """Refuse a file with a section that is nearly a node's, or is its in another namespace.

    ROS ignores such a section without a word.

    Parameters
    ----------
    args : sequence of str
        Command line, as for :func:`shared_names`.
    nodes : collection of str
        Full names of the nodes that it starts.

    Raises
    ------
    ConfigError
        If a file has no section for one of them, but one that must have been meant for it.
    """
    files = [read(value) for option, value in _ros_options(args) if option == "--params-file"]
    for file in files:
        for node in nodes:
            name = node.rpartition("/")[2]
            if file.describes(node):
                continue
            if keys := [section.key for section in file.sections if section.node == name]:
                raise ConfigError(
                    f"{file.path}: '{keys[0]}' is not {node}, which this node is: write '{node}', "
                    f"or '/**/{name}' for every namespace"
                )
            file._refuse_misspelt({name})


def write(values: Mapping[str, Mapping[str, Any]], path: str | Path) -> None:
    """Write values by node, of any namespace, as a parameter file."""
    content = {f"/**/{node}": {"ros__parameters": dict(given)} for node, given in values.items()}
    text = yaml.dump(content, Dumper=_Dumper, sort_keys=False)
    Path(path).write_text(text, encoding="utf-8")


def as_yaml(value: Any) -> str:
    """Return a value as ROS reads it back, of the same type."""
    plain = list(value) if isinstance(value, tuple) else value
    text = yaml.dump(plain, Dumper=_Dumper, default_flow_style=True, width=math.inf)
    return text.removesuffix("...\n").strip()


def shared_names(args: Sequence[str]) -> set[str]:
    """Return the parameters that files give to nodes of any name only, and nobody to one by name.

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
            with suppress(ConfigError):
                for section in read(value).sections:
                    (shared if section.for_any else named).update(section.values)
        elif option in ("-p", "--param"):
            named.add(value.partition(":=")[0].rpartition(":")[2])
    return shared - named


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
    for key, given in content.items():
        name = f"{above}/{str(key).strip('/')}"
        if not isinstance(given, dict):
            raise ConfigError(f"{path}: '{name}' has no ros__parameters")
        if "ros__parameters" not in given:
            yield from _sections(path, name, given)
        elif isinstance(given["ros__parameters"], dict):
            yield NodeSection(name, dict(_flat("", given["ros__parameters"])))
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
        found: dict[Any, Any] = {}
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise yaml.constructor.ConstructorError(None, None, "a key is not a name")
            _merge(found, {key.value: self.construct_object(value, deep=True)})
        return found


def _merge(found: dict[Any, Any], more: dict[Any, Any]) -> None:
    for key, value in more.items():
        if isinstance(value, dict) and isinstance(found.get(key), dict):
            _merge(found[key], value)
        else:
            found[key] = value


class _Dumper(yaml.SafeDumper):
    """Quotes a text that rcl would take for a number, such as 1e3."""


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
