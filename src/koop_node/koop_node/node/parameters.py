"""ROS parameters from configuration classes: declared, described, changed whole or not at all."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import asdict, fields
from typing import Any, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from koop_core.config.knobs import KnobSettings
from koop_core.config.parameter import ConfigError, Spec, refuse_unknown, spec_of
from koop_core.config.parameter_file import shared_names
from koop_core.errors import KoopError
from koop_node.node.rclpy_internals import parameter_overrides

Config = TypeVar("Config")
OF_THE_CLOCK = "qos_overrides./clock."  # rclpy's own, with use_sim_time


class Parameters:
    """The configurations of a node, each an immutable object that is swapped when it changes.

    A field name that several of the classes share is one ROS parameter. ``check(changed, names)``
    is called with a new value of every configuration, by class, and the names that were set, before
    it is taken; it raises KoopError to refuse it. ``changed(names)`` is called after that.

    Raises ConfigError if a value at the start is unknown, out of range or of the wrong type. What a
    file says to all nodes of a wildcard may be unknown; ``args`` is the command line that names it.
    """

    def __init__(
        self,
        node: Node,
        config_classes: Iterable[type],
        check: Callable[[dict[type, Any], set[str]], None],
        changed: Callable[[set[str]], None],
        args: Sequence[str] = (),
    ) -> None:
        self._classes = tuple(config_classes)
        self._check = check
        self._changed = changed
        overrides = parameter_overrides(node)
        by_name = {item.name: item for cls in self._classes for item in fields(cls)}
        shared = shared_names(args, node.get_fully_qualified_name())
        unknown = sorted(
            name
            for name in overrides
            if not (name in by_name or node.has_parameter(name) or name.startswith(OF_THE_CLOCK))
        )
        refuse_unmeant(unknown, by_name, shared)
        if unknown:
            node.get_logger().info(f"given to all nodes, not known here: {', '.join(unknown)}")
        self._defaults = {item.name: item.default for item in by_name.values()}
        self._configs = self._build(self._defaults | overrides)
        self._pending: dict[type, Any] | None = None
        values = self._values(self._configs)
        for item in by_name.values():
            value = values[item.name]
            node.declare_parameter(
                item.name,
                list(value) if isinstance(value, tuple) else value,
                descriptor(spec_of(item), item.default),
                ignore_override=True,
            )
        node.add_pre_set_parameters_callback(self._as_declared)
        node.add_on_set_parameters_callback(self._on_set)
        node.add_post_set_parameters_callback(self._on_taken)

    def __getitem__(self, config_class: type[Config]) -> Config:
        """Return the current configuration of a class."""
        config: Config = self._configs[config_class]
        return config

    def _build(self, values: dict[str, Any]) -> dict[type, Any]:
        return {
            cls: cls(**{item.name: values[item.name] for item in fields(cls)})
            for cls in self._classes
        }

    @staticmethod
    def _values(configs: dict[type, Any]) -> dict[str, Any]:
        return {
            name: value for config in configs.values() for name, value in asdict(config).items()
        }

    def _as_declared(self, parameters: list[Parameter]) -> list[Parameter]:
        """Return the parameters with whole numbers as floats where floats are declared."""
        return [_in_type_of(self._defaults.get(item.name), item) for item in parameters]

    def _on_set(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            values = self._values(self._configs) | {p.name: p.value for p in parameters}
            pending = self._build(values)
            for cls, config in pending.items():
                if isinstance(config, KnobSettings) and config.count != self._configs[cls].count:
                    raise ConfigError("the number of knobs is fixed while the node runs")
            self._check(pending, {p.name for p in parameters})
        except KoopError as error:
            return SetParametersResult(successful=False, reason=str(error))
        self._pending = pending
        return SetParametersResult(successful=True)

    def _on_taken(self, parameters: list[Parameter]) -> None:
        if self._pending is not None:
            self._configs, self._pending = self._pending, None
            self._changed({p.name for p in parameters})


def descriptor(spec: Spec, default: Any) -> ParameterDescriptor:
    """Return the ROS descriptor of a parameter with its description, unit and range."""
    unit = f" [{spec.unit}]" if spec.unit else ""
    ranged = math.isfinite(spec.high) and not spec.per_knob  # a range is of one number
    result = ParameterDescriptor(
        description=spec.description + unit,
        additional_constraints="" if ranged else spec.constraint,
        read_only=spec.read_only,
        # ROS cannot tell the type of an empty list
        dynamic_typing=isinstance(default, tuple) or spec.per_knob,
    )
    if ranged and math.isfinite(spec.low):
        if type(default) is float:
            result.floating_point_range = [
                FloatingPointRange(from_value=float(spec.low), to_value=float(spec.high))
            ]
        elif type(default) is int:
            result.integer_range = [IntegerRange(from_value=int(spec.low), to_value=int(spec.high))]
    return result


def _in_type_of(default: Any, item: Parameter) -> Parameter:
    """Return a parameter as its default's type has it: '5' is a float where one is declared."""
    if isinstance(default, float) and item.type_ == Parameter.Type.INTEGER:
        return Parameter(item.name, Parameter.Type.DOUBLE, float(item.value))
    if isinstance(default, tuple | float) and item.type_ == Parameter.Type.INTEGER_ARRAY:
        return Parameter(item.name, Parameter.Type.DOUBLE_ARRAY, [float(x) for x in item.value])
    return item


def refuse_unmeant(unknown: Iterable[str], by_name: Iterable[str], shared: Collection[str]) -> None:
    """Raise ConfigError on an unknown name, unless a file gave it to all nodes."""
    for name in unknown:
        if name.startswith("qos_overrides."):
            raise ConfigError(
                f"{name}: the quality of service of the topics is fixed, and publishers of any "
                "reliability are heard"
            )
    refuse_unknown([name for name in unknown if name not in shared], sorted(by_name))
