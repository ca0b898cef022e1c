"""Lockstep of the player: each state is published when the theta for the last one has come."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from koop_bag.bag.reader import BagReader, RawMessage
from koop_bag.cdr.header import has_step, step_of
from koop_bag.cdr.schema import load_schema
from koop_bag.errors import BagError
from koop_bag.player.config import ANSWER
from koop_bag.player.outlet import Outlet, recorded_qos
from koop_bag.recorder.config import LOOP_TOPICS
from koop_bag.recorder.topics import message_class
from koop_core.stream.resend import Due, Resend
from koop_node.node.managed import Entities
from koop_node.node.qos import RELIABLE

TIMEOUT = 2.0  # [s] without an answer after which a state is sent again
RESENDS = 3  # times that a state without an answer is sent again before giving up


class Gate:
    """Waits for the theta of each state.

    Parameters
    ----------
    node : rclpy.node.Node
        Whose logger is used.
    entities : Entities
        Owner of the subscription.
    bag : BagReader
        The bag, which tells type and reliability of the answers.
    outlet : Outlet
        Topic whose messages are answered; both types begin with a header and a step.
    answer : str
        Topic of the answers, by its name in the bag.
    name : str
        Topic on which they are expected.
    answered : callable
        Called when the answer has come.

    Raises
    ------
    BagError
        If one of the types has no step.
    """

    def __init__(
        self,
        node: Node,
        entities: Entities,
        bag: BagReader,
        outlet: Outlet,
        answer: str,
        name: str,
        answered: Callable[[], None],
    ) -> None:
        recorded = next((topic for topic in bag.topics if topic.name == answer), None)
        type_name = recorded.type_name if recorded else LOOP_TOPICS[ANSWER]
        for kind in (bag.topic(outlet.topic).type_name, type_name):
            if not has_step(load_schema(kind)):
                raise BagError(f"lockstep: {kind} has no step")
        self._outlet, self._answer = outlet, answer
        self._answered, self._node = answered, node
        self._asked: RawMessage | None = None
        self._question = Resend(TIMEOUT, RESENDS)
        offered = recorded_qos(recorded) if recorded else []
        reliable = all(item.reliability == "reliable" for item in offered)
        policy = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        entities.subscription(
            message_class(type_name),
            name,
            self._on_answer,
            QoSProfile(depth=RELIABLE.depth, reliability=policy),
            raw=True,
        )

    @property
    def topic(self) -> str:
        """Topic whose messages are answered, by its name in the bag."""
        return self._outlet.topic

    @property
    def overdue(self) -> bool:
        """Whether a message had to be sent again and there is still no answer."""
        return self._question.overdue

    def ask(self, message: RawMessage) -> None:
        """Expect the answer to a message that went out."""
        self._asked = message
        self._question.ask(time.monotonic())

    def forget(self) -> bool:
        """Expect nothing any more; return whether an answer was overdue."""
        self._asked = None
        return self._question.close()

    def check(self) -> bool:
        """Send a message again whose answer is overdue; return False to give up."""
        due = self._question.check(time.monotonic())
        if due is Due.AGAIN and self._asked is not None:
            again = f"sending it again ({self._question.resent} of {RESENDS})"
            self._node.get_logger().warning(f"{self.silence()}: {again}")
            self._outlet.publish(self._asked.data)
        return due is not Due.GIVE_UP

    def silence(self) -> str:
        """Return a line on the answer that is missing."""
        what = f"no {self._answer} in {self._question.timeout:g} s for {self.topic}"
        if self._asked is not None:
            what += f" of step {step_of(self._asked.data)}"
        heard = self._outlet.publisher.get_subscription_count()
        return what if heard else what + ", which has no subscribers any more"

    def _on_answer(self, data: Any) -> None:
        if self._asked is None or step_of(data) != step_of(self._asked.data):
            return
        if self.forget():
            self._node.get_logger().info("the answer was received late")
        self._answered()
