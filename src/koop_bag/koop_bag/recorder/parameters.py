"""Collects the parameters of the nodes around the recorder."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.node import Node

from koop_node.client.question import Question
from koop_node.node.received import read_value

WAITED_FOR = "listeners"  # a parameter of the nodes, see koop_core.config.parameter


class ParameterCollector:
    """Asks every node of a namespace once for all its parameters.

    Left out are the parameters of this start: `listeners`, and the recorder's `output`.
    The file starts another run, which would wait for nodes that are not there, or write where a
    recording is.

    Later changes need no asking: they are recorded from /parameter_events. There a node also
    announces its parameters before it begins, for a short run may end before it has answered. The
    asking node's own are included.
    """

    def __init__(self, node: Node, namespace: str) -> None:
        self._node = node
        self._prefix = namespace.rstrip("/") + "/"
        self._asked: dict[str, _Request] = {}
        self._answered: set[str] = set()
        self._heard = False  # an announcement, since the last look
        self.values: dict[str, dict[str, Any]] = {}
        """Parameters by full node name."""
        self._own = node.get_fully_qualified_name()

    def look(self) -> bool:
        """Ask nodes that are new, take answers in; return whether any has come."""
        nodes = {
            f"{namespace.rstrip('/')}/{name}"
            for name, namespace in self._node.get_node_names_and_namespaces()
            if not name.startswith("_")
        }
        self._answered &= self.values.keys()  # whose values were dropped is asked again
        first = self._own not in self.values
        if first:
            declared: Any = self._node.get_parameters_by_prefix("")  # Parameters of rclpy
            self.values[self._own] = {
                name: read_value(item.get_parameter_value())
                for name, item in declared.items()
                if name not in ("output", WAITED_FOR)
            }
        for name in nodes - self._answered - self._asked.keys() - {self._own}:
            if name.startswith(self._prefix):
                self._asked[name] = _Request(self._node, name)
        taken = self.take()
        for name in self._asked.keys() - nodes:
            self._asked.pop(name).close()
        return taken or first

    def take(self) -> bool:
        """Take answers in and ask on; return whether anything new is known.

        To be called often: a node that answers may end soon.
        """
        new, self._heard = self._heard, False
        for name, request in list(self._asked.items()):
            request.advance()
            if request.values is not None:
                self._add(name, request.values)
                self._asked.pop(name).close()
                self._answered.add(name)
                new = True
        return new

    def hear(self, event: ParameterEvent) -> None:
        """Take what a node announces."""
        within = event.node.startswith(self._prefix) and "/_" not in event.node
        if within and event.node != self._own and event.new_parameters:
            announced = event.new_parameters
            values = {p.name: read_value(p.value) for p in announced}
            self._add(event.node, values)
            self._heard = True

    def _add(self, node: str, values: Mapping[str, Any]) -> None:
        """Add parameters; those that are known already stay, for they came before any change."""
        added = {name: value for name, value in values.items() if name != WAITED_FOR}
        self.values[node] = added | self.values.get(node, {})

    def close(self) -> None:
        """Give up the open requests."""
        for request in self._asked.values():
            request.close()
        self._asked.clear()


class _Request:
    """Two calls to one node: which parameters are there, then their values."""

    def __init__(self, node: Node, name: str) -> None:
        self._node = node
        self._list = node.create_client(ListParameters, f"{name}/list_parameters")
        self._get = node.create_client(GetParameters, f"{name}/get_parameters")
        self._question: Question | None = None
        self._names: list[str] | None = None
        self.values: dict[str, Any] | None = None

    def advance(self) -> None:
        if self._question is None:
            if self._list.service_is_ready() and self._get.service_is_ready():
                self._question = Question(self._list, ListParameters.Request())
            return
        answer = self._question.answer()
        if answer is None:
            return
        if self._names is None:
            self._names = list(answer.result.names)
            self._question = Question(self._get, GetParameters.Request(names=self._names))
        else:
            values = list(map(read_value, answer.values))
            self.values = dict(zip(self._names, values, strict=False))

    def close(self) -> None:
        self._node.destroy_client(self._list)
        self._node.destroy_client(self._get)
