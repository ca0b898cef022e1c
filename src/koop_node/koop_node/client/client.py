"""A client in a ROS domain: looks at the graph, publishes, listens and calls, on its own context.

For programs that are not nodes themselves: they leave the domain when they are done with it. rclpy
is imported only when one is made, so that what can do without ROS does.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Mapping
from types import FrameType
from typing import Any, TypeVar

from koop_core.errors import LiveError
from koop_node.client.question import ASK_AGAIN, Question

ANSWER = 5.0  # [s] for a node to answer a call
ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
Check = Callable[[], object] | None
Result = TypeVar("Result")
Own = TypeVar("Own", bound="Client")


class Client:
    """A node with a context and an executor of its own; a context manager.

    By default the ROS domain is the one of the environment; ``udp`` is
    :func:`koop_node.node.dds_profile.set_dds_profile`'s, the options are every rclpy node's.
    """

    def __init__(
        self, name: str, domain: int | None = None, udp: bool = True, **options: Any
    ) -> None:
        import rclpy
        from rclpy.experimental.events_executor import EventsExecutor

        from koop_node.node.dds_profile import set_dds_profile
        from koop_node.node.rclpy_internals import WithoutEvents

        set_dds_profile(udp)
        self._context = rclpy.Context()
        self._context.init(args=[], domain_id=domain)
        self.node = WithoutEvents(name, context=self._context, **options)
        self._executor: Any = EventsExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._services: dict[str, Any] = {}
        self._signals = _Signals()

    def __enter__(self: Own) -> Own:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the domain."""
        self._signals.close()
        self._executor.remove_node(self.node)
        self.node.destroy_node()
        self._executor.shutdown()
        self._context.try_shutdown()

    def spin(self, seconds: float) -> None:
        """Wait for an event, no longer than a time, and process it.

        Ctrl-C and its like come after that: within a callback, rclpy would print where it was.
        """
        with self._signals:
            self._executor.spin_once(timeout_sec=seconds)

    def wait_for(
        self, condition: Callable[[], Result], seconds: float, what: str, check: Check = None
    ) -> Result:
        """Spin until a condition, ``what`` in words, is true, and return it.

        Meanwhile ``check`` is called; it may raise. Raises LiveError if the condition did not
        become true in so many seconds.
        """
        if not (result := self.spin_until(condition, seconds, check)):
            raise LiveError(f"{what}: timed out after {seconds:g} s")
        return result

    def spin_until(
        self, condition: Callable[[], Result], seconds: float, check: Check = None
    ) -> Result:
        """Spin until a condition is true or the time is over; return what it last was."""
        deadline = time.monotonic() + seconds
        while not (result := condition()) and time.monotonic() <= deadline:
            self.spin(0.05)
            if check is not None:
                check()
        return result

    def call(
        self,
        service_type: Any,
        name: str,
        request: Any,
        seconds: float = ANSWER,
        check: Check = None,
    ) -> Any:
        """Call a service and return its answer; as :meth:`wait_for`.

        It is asked again until it is answered, see :class:`~koop_node.client.question.Question`.
        """
        question = Question(self._service(service_type, name, seconds, check), request)
        return self.wait_for(question.answer, seconds, f"an answer of {name}", check)

    def _service(self, service_type: Any, name: str, seconds: float, check: Check) -> Any:
        """Return the client of a service that is ready."""
        if name not in self._services:
            self._services[name] = self.node.create_client(service_type, name)
        client = self._services[name]
        self.wait_for(client.service_is_ready, seconds, f"the service {name}", check)
        return client

    def set_parameters(
        self, node: str, values: Mapping[str, Any], seconds: float = ANSWER, check: Check = None
    ) -> None:
        """Change parameters of a running node, all or none; as :meth:`call`.

        Raises LiveError if the node does not answer or refuses.
        """
        from rcl_interfaces.srv import SetParametersAtomically
        from rclpy.parameter import Parameter

        asked = [Parameter(k, value=v).to_parameter_msg() for k, v in values.items()]
        request = SetParametersAtomically.Request(parameters=asked)
        service = f"{node}/set_parameters_atomically"
        answer = self.call(SetParametersAtomically, service, request, seconds, check).result
        if not answer.successful:
            raise LiveError(f"{node} refuses {', '.join(values)}: {answer.reason}")

    def change_state(
        self, node: str, transition: str, seconds: float = ANSWER, check: Check = None
    ) -> None:
        """Make a node ``configure``, ``activate``, ``deactivate`` or ``cleanup``; as :meth:`call`.

        Raises LiveError if the node does not answer or refuses.
        """
        from lifecycle_msgs.msg import State, Transition
        from lifecycle_msgs.srv import ChangeState, GetState

        number, aim = {
            "configure": (Transition.TRANSITION_CONFIGURE, State.PRIMARY_STATE_INACTIVE),
            "activate": (Transition.TRANSITION_ACTIVATE, State.PRIMARY_STATE_ACTIVE),
            "deactivate": (Transition.TRANSITION_DEACTIVATE, State.PRIMARY_STATE_INACTIVE),
            "cleanup": (Transition.TRANSITION_CLEANUP, State.PRIMARY_STATE_UNCONFIGURED),
        }[transition]
        request = ChangeState.Request(transition=Transition(id=number))
        service = f"{node}/change_state"
        asked = self._service(ChangeState, service, seconds, check).call_async(request)
        deadline = time.monotonic() + seconds

        def state() -> Any:
            left = max(deadline - time.monotonic(), ASK_AGAIN)
            answer = self.call(GetState, f"{node}/get_state", GetState.Request(), left, check)
            return answer.current_state

        while not self.spin_until(asked.done, ASK_AGAIN, check):
            # ask for its state, not for the transition again: done already, it would be refused
            if state().id == aim:  # the answer got lost
                return
            if time.monotonic() > deadline:
                raise LiveError(f"{service}: timed out after {seconds:g} s")
        if not asked.result().success and (now := state()).id != aim:
            raise LiveError(f"{node} is {now.label} and cannot {transition}")


class _Signals:
    """Keeps back the signals that end a program while a client is in a callback.

    Set once a client: to set three handlers and to put them back takes as long as a message.
    """

    def __init__(self) -> None:
        self._busy = False
        self._came: list[tuple[int, FrameType | None]] = []
        self._before: dict[int, Any] = {}
        self._main = threading.main_thread().ident
        if threading.get_ident() != self._main:  # only there can handlers be set
            return
        for number in ENDS:
            before = signal.getsignal(number)
            if before is not None and before != signal.SIG_IGN:
                self._before[number] = before
                signal.signal(number, self._on_signal)

    def __enter__(self) -> None:
        self._busy = threading.get_ident() == self._main

    def __exit__(self, *error: object) -> None:
        self._busy = False
        while self._came:
            self._pass_on(*self._came.pop(0))

    def close(self) -> None:
        """Put back the handlers that were there, unless others were set since."""
        for number, before in self._before.items():
            if signal.getsignal(number) == self._on_signal:
                signal.signal(number, before)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if self._busy:
            self._came.append((number, frame))
        else:
            self._pass_on(number, frame)

    def _pass_on(self, number: int, frame: FrameType | None) -> None:
        before = self._before[number]
        if callable(before):
            before(number, frame)
        else:
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
