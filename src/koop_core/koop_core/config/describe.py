"""The parameters of a node in words: its ``--help`` and annotated parameter files. Pure."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import Field, fields
from typing import Any

from koop_core.config.parameter import spec_of
from koop_core.config.parameter_file import as_yaml

WIDTH = 100
FIXED = ", fixed while the node runs"
ARGUMENTS = "--ros-args [-p NAME:=VALUE] [--params-file FILE] [-r FROM:=TO]"


def parameters_of(classes: Iterable[type]) -> list[Field[Any]]:
    """Return the parameters of configuration classes in their order; a shared name comes once."""
    return list({item.name: item for cls in classes for item in fields(cls)}.values())


def allowed(item: Field[Any]) -> str:
    """Return the values that a parameter may have, in words, with its unit."""
    spec, default = spec_of(item), item.default
    kind = "text"
    if isinstance(default, bool):
        kind = "true or false"
    elif isinstance(default, tuple):
        kind = "list of numbers"
    elif isinstance(default, int):
        kind = "whole number"
    elif isinstance(default, float):
        kind = f"number [{spec.unit}]" if spec.unit and not spec.constraint else "number"
    if spec.choices:
        kind = spec.constraint
    elif spec.constraint:
        kind = f"{kind}, {spec.constraint}"
    if spec.per_knob:
        kind = f"{kind}; or a list, one for each knob"
    return f"{kind}{FIXED}" if spec.read_only else kind


def help_text(program: str, purpose: str, classes: Iterable[type]) -> str:
    """Return what ``--help`` of a node prints: how it is started, what it does, its parameters."""
    usage = _wrapped(f"usage: {program} {ARGUMENTS}", "", "    ")
    lines = [*usage, "", *_wrapped(purpose), ""]
    lines.append("parameters (NAME = default: what it may be)")
    for item in parameters_of(classes):
        head = f"{item.name} = {as_yaml(item.default)}: {allowed(item)}"
        lines += ["", *_wrapped(head, "  ", "    ")]
        lines += _wrapped(spec_of(item).description, "      ")
    return "\n".join(lines)


def parameter_file(
    nodes: Mapping[str, Iterable[type]],
    values: Mapping[str, Mapping[str, Any]] | None = None,
    reasons: Mapping[str, Mapping[str, str]] | None = None,
) -> str:
    """Return a ROS 2 parameter file, each value explained in a comment above it.

    All by node: configuration classes, values that are not the default, and the reasons of those.
    """
    chosen, why = values or {}, reasons or {}
    return "".join(
        f"{line}\n"
        for node, classes in nodes.items()
        for line in _section(node, classes, chosen.get(node, {}), why.get(node, {}))
    )


def _section(
    node: str, classes: Iterable[type], values: Mapping[str, Any], reasons: Mapping[str, str]
) -> Iterator[str]:
    yield ""
    yield f"/**/{node}:"
    yield "  ros__parameters:"
    for item in parameters_of(classes):
        value = values.get(item.name, item.default)
        yield from _wrapped(spec_of(item).description, "    # ")
        yield from _wrapped(f"({allowed(item)})", "    # ")
        if item.name in values and item.name in reasons:
            yield from _wrapped(f"Here: {reasons[item.name]}.", "    # ")
        empty = value == ()  # of which ROS cannot tell the type
        yield f"    {'# ' if empty else ''}{item.name}: {as_yaml(value)}"


def _wrapped(text: str, first: str = "", then: str | None = None) -> list[str]:
    return textwrap.wrap(
        text, WIDTH, initial_indent=first, subsequent_indent=first if then is None else then
    )
