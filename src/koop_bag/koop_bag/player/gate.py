"""Lockstep of the player: a message goes out, the loop answers, the next one goes out."""

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
from koop_bag.player.outlet import Outlet, recorded_qos
from koop_bag.recorder.config import LOOP_TOPICS
from koop_bag.recorder.topics import message_class
from koop_core.stream.resend import Due, Resend
from koop_node.node.managed import Entities
from koop_node.node.qos import RELIABLE

RESENDS = 3  # times that a message without an answer is sent again before giving up


class Gate:
    """Waits for the answer to each message of one topic.

    Parameters
    ----------
    node : rclpy.node.Node
        Whose logger is used.
    entities : Entities
        Owner of the subscription.
    bag : BagReader
        The bag; tells type and reliability of the answers.
    outlet : Outlet
        Topic whose messages are answered.
    answer : str
        Topic of the answers, by its name in the bag.
    name : str
        Topic on which they are expected.
    timeout : float
        How long an answer may take before the message is sent again [s].
    answered : callable
        Called when the answer has come.

    Notes
    -----
    An answer belongs to the message with the same step. Where the types have no step, every
    message on the topic is an answer.
    """

    def __init__(
        self,
        node: Node,
        entities: Entities,
        bag: BagReader,
        outlet: Outlet,
        answer: str,
        name: str,
        timeout: float,
        answered: Callable[[], None],
    ) -> None:
        recorded = next((topic for topic in bag.topics if topic.name == answer), None)
        type_name = recorded.type_name if recorded else LOOP_TOPICS.get(answer.rsplit("/", 1)[-1])
        if type_name is None:
            raise BagError(f"answer: the bag has no {answer}, so its type is not known")
        types = (type_name, bag.topic(outlet.topic).type_name)
        self._by_step = all(has_step(load_schema(item)) for item in types)
        self._outlet, self._answer = outlet, answer
        self._answered, self._node = answered, node
        self._asked: RawMessage | None = None
        self._question = Resend(timeout, RESENDS)
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
        """Say who does not answer to what."""
        what = f"no {self._answer} in {self._question.timeout:g} s for {self.topic}"
        if self._asked is not None and self._by_step:
            what += f" of step {step_of(self._asked.data)}"
        heard = self._outlet.publisher.get_subscription_count()
        return what if heard else what + ", which has no subscribers any more"

    def _on_answer(self, data: Any) -> None:
        if self._asked is None or (self._by_step and step_of(data) != step_of(self._asked.data)):
            return
        if self.forget():
            self._node.get_logger().info("the answer was received late")
        self._answered()
