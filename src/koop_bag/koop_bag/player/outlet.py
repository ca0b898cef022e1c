"""Publishers of the player: the recorded bytes go out as they are."""

from __future__ import annotations

import time

from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)

from koop_bag.bag.metadata import OfferedQos, parse_qos
from koop_bag.bag.reader import BagTopic
from koop_bag.cdr.schema import load_schema
from koop_bag.errors import BagError
from koop_node.node.managed import Entities, message_type

DEPTH = 1000
"""Messages that a writer keeps at least. Discovery does not give a recorder the depth that was
offered, and a player may be faster than the node it replaces."""

STUCK = 2.0
"""Time [s] after which a listener that does not acknowledge is not waited for any more."""


class Outlet:
    """One topic being played.

    Raises
    ------
    koop_core.errors.KoopError
        If its messages cannot be published as they are: another encoding, a type that is not
        installed, or one that is installed in another version than the recorded one.
    """

    def __init__(self, entities: Entities, topic: BagTopic) -> None:
        if topic.encoding != "cdr":
            raise BagError(f"{topic.name} is encoded as '{topic.encoding}', not as cdr")
        installed = load_schema(topic.type_name).type_hash
        recorded = topic.metadata.get("topic_type_hash", "")
        if installed and recorded and installed != recorded:
            raise BagError(
                f"{topic.name} was recorded with another version of {topic.type_name} than the "
                "one that is installed"
            )
        self.topic = topic.name
        self.count = 0
        profile = qos_profile(parse_qos(topic.metadata.get("offered_qos_profiles", "")))
        self.publisher = entities.publisher(message_type(topic.type_name), topic.name, profile)
        self._patience = profile.depth // 2
        """Messages after which a player without a clock waits for its subscribers."""
        self._stuck = False

    def publish(self, data: bytes, acknowledged: bool) -> None:
        """Publish a serialized message.

        If `acknowledged`, wait now and then until the reliable subscribers have everything.
        """
        self.publisher.publish(data)
        self.count += 1
        if acknowledged and self.count % self._patience == 0 and not self._stuck:
            self._stuck = not self.wait_for_listeners(STUCK)

    def wait_for_listeners(self, timeout: float) -> bool:
        """Wait until all that was sent is acknowledged; return whether it is."""
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            if self.publisher.wait_for_all_acked(Duration(seconds=0.1)):
                return True
        return False


def qos_profile(offered: list[OfferedQos]) -> QoSProfile:
    """Return one profile that suits every subscriber of any of the recorded publishers.

    A publisher that offers more than requested still matches, so the strongest of each policy
    is taken; a deadline or lifespan only if all had the same.
    """
    profiles = offered or [OfferedQos()]
    first = profiles[0]

    def common(name: str) -> Duration:
        values = {getattr(item, name) for item in profiles}
        span = values.pop() if len(values) == 1 else None
        return Duration() if span is None else Duration(seconds=span[0], nanoseconds=span[1])

    reliable = any(item.reliability == "reliable" for item in profiles)
    kept = any(item.durability == "transient_local" for item in profiles)
    everything = first.history == "keep_all"
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL if everything else HistoryPolicy.KEEP_LAST,
        depth=max(DEPTH, *(item.depth for item in profiles)),
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE,
        deadline=common("deadline"),
        lifespan=common("lifespan"),
        # the player is alive as long as its process: what 'automatic' asserts
        liveliness=LivelinessPolicy.AUTOMATIC,
    )
