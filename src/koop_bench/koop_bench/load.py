"""A publisher of the loop's four topics at any rate, for measuring recorders.

Run as ``python -m koop_bench.load RATE SECONDS [FAREWELL]``; prints a line of JSON ten times a
second, when all is sent, and at its end: at the latest FAREWELL seconds later, whoever still lacks
something.
The messages are serialized in advance, their values random, so that compression has nothing to
find that a real run would not have.
"""

from __future__ import annotations

import json
import random
import sys
import time
from typing import Any

from koop_bag.recorder.config import LOOP_TOPICS

VARIANTS = 2000  # different messages of a topic: more than a chunk of the file holds
STEP_AT = 20  # bytes before the step of a message whose frame id is empty


def main(rate: float, seconds: float, farewell: float = 10.0) -> None:
    """Publish; step k goes out k / rate after the first."""
    import rclpy
    from rclpy.duration import Duration

    from koop_bag.recorder.topics import message_class
    from koop_node.node.main import set_dds_profile
    from koop_node.node.qos import RELIABLE
    from koop_node.process.lifeline import end_with_parent

    end_with_parent()
    set_dds_profile()
    rclpy.init()
    node = rclpy.create_node("load")
    pools, publishers = [], []
    for topic, type_name in LOOP_TOPICS.items():
        pools.append(serialized_variants(message_class(type_name)))
        publishers.append(node.create_publisher(message_class(type_name), topic, RELIABLE))
    while not all(publisher.get_subscription_count() for publisher in publishers):
        time.sleep(0.02)
    steps = round(rate * seconds)
    begin = told = time.monotonic()
    for k in range(steps):
        due = begin + k / rate
        while (now := time.monotonic()) < due:
            time.sleep(due - now)
        step = k.to_bytes(8, "little")
        for publisher, pool in zip(publishers, pools, strict=True):
            head, tail = pool[k % VARIANTS]
            publisher.publish(head + step + tail)
        if now - told >= 0.1:
            told = now
            print(json.dumps({"sent": k + 1}), flush=True)
    elapsed = time.monotonic() - begin
    print(json.dumps({"sent": steps}), flush=True)
    over = time.monotonic() + farewell
    for publisher in publishers:
        publisher.wait_for_all_acked(Duration(seconds=max(0.0, over - time.monotonic())))
    payload = sum(sum(len(a) + 8 + len(b) for a, b in pool) for pool in pools)
    mean = payload / (len(pools) * VARIANTS)
    print(json.dumps({"sent": steps, "elapsed": elapsed, "payload": mean}), flush=True)
    node.destroy_node()
    rclpy.try_shutdown()


def serialized_variants(kind: Any) -> list[tuple[bytes, bytes]]:
    """Return messages of random values, each as the bytes before and after its step."""
    from rclpy.serialization import serialize_message

    rng = random.Random(1)
    variants = []
    for number in range(VARIANTS):
        message = kind()
        message.header.stamp.sec = number
        for name, type_name in kind.get_fields_and_field_types().items():
            if type_name == "double":
                setattr(message, name, rng.gauss(0.0, 1.0))
            elif type_name == "sequence<double>":
                setattr(message, name, [rng.gauss(0.0, 1.0), rng.gauss(0.0, 1.0)])
            elif type_name == "string":
                setattr(message, name, "6c06224ad266")
        data = serialize_message(message)
        variants.append((data[:STEP_AT], data[STEP_AT + 8 :]))
    return variants


if __name__ == "__main__":
    main(*map(float, sys.argv[1:]))
