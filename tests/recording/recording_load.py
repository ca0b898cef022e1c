"""A publisher of the loop's four topics at any rate, for measuring recorders.

Run as ``python recording_load.py RATE SECONDS [FAREWELL]``; prints a line of JSON ten times a
second, when all is sent, and at its end: at the latest FAREWELL seconds later, whoever still lacks
something.
The messages are serialized in advance, their values random, so that compression has nothing to
find that a real run would not have.
"""

from __future__ import annotations

import json
import math
import random
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from koop_bag.bag.columns import read_columns
from koop_bag.bag.losses import StepReport, count_losses
from koop_bag.bag.reader import BagReader
from koop_bag.recorder.config import LOOP_TOPICS
from koop_bench.figures import processor_time
from koop_bench.record import reported_losses
from koop_bringup.live.process import NodeProcess, TiedProcess
from koop_core.errors import LiveError

VARIANTS = 2000  # different messages of a topic: more than a chunk of the file holds
STEP_AT = 20  # bytes before the step of a message whose frame id is empty


def main(rate: float, seconds: float, farewell: float = 10.0) -> None:
    """Publish; step k goes out k / rate after the first."""
    import rclpy
    from rclpy.duration import Duration

    from koop_node.node.dds_profile import set_dds_profile
    from koop_node.node.managed import message_type
    from koop_node.node.qos import RELIABLE
    from koop_node.process.lifeline import end_with_parent

    end_with_parent()
    set_dds_profile()
    rclpy.init()
    node = rclpy.create_node("load")
    pools, publishers = [], []
    for topic, type_name in LOOP_TOPICS.items():
        pools.append(serialized_variants(message_type(type_name)))
        publishers.append(node.create_publisher(message_type(type_name), topic, RELIABLE))
    while not all(publisher.get_subscription_count() for publisher in publishers):
        time.sleep(0.02)
    steps = round(rate * seconds)
    begin = lines = time.monotonic()
    for k in range(steps):
        due = begin + k / rate
        while (now := time.monotonic()) < due:
            time.sleep(due - now)
        step = k.to_bytes(8, "little")
        for publisher, pool in zip(publishers, pools, strict=True):
            head, tail = pool[k % VARIANTS]
            publisher.publish(head + step + tail)
        if now - lines >= 0.1:
            lines = now
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


@dataclass(frozen=True)
class LoadReport:
    """What a recorder made of a load.

    Attributes
    ----------
    rate, elapsed : float
        Steps a second that were asked for, and how long all took [s].
    sent : int
        Messages of each of the four topics.
    recorded : dict of str to StepReport
        What the steps in the bag say, by topic.
    counted : int
        Losses in all that the recorder reported: gaps, late begins and early ends.
    cpu : float
        Processor time of the recorder as a share of one core.
    stored, payload : float
        Bytes on the disk and serialized bytes, both by message.
    """

    rate: float
    elapsed: float
    sent: int
    recorded: dict[str, StepReport]
    counted: int
    cpu: float
    stored: float
    payload: float

    @property
    def missing(self) -> int:
        """Messages that were sent and are not in the bag."""
        return sum(self.sent - steps.count for steps in self.recorded.values())

    def text(self) -> str:
        """The report for people."""
        total = self.sent * len(self.recorded)
        return (
            f"{self.rate:g} Hz x {len(self.recorded)} for {self.elapsed:.1f} s: {total} messages "
            f"sent, {self.missing} missing, {self.counted} reported as lost; recorder "
            f"{self.cpu:.1%} of a core; {self.stored:.1f} B a message on the disk, "
            f"{self.payload:.1f} B of it payload before compression"
            + ("" if self.missing == self.counted else f"\nNOT REPORTED: {self.recorded}")
        )


def record_load(
    folder: Path,
    rate: float,
    seconds: float,
    stall: float = 0.0,
    farewell: float = 10.0,
    **parameters: object,
) -> LoadReport:
    """Record a load of `rate` steps a second on four topics; a stalled recorder is not scheduled.

    Parameters
    ----------
    folder : path
        Of the run.
    rate, seconds : float
        Steps a second, and how long.
    stall : float
        After a second the recorder is stopped until so much more was sent [s], or everything.
    farewell : float
        How long those who sent stay for a recorder that lacks something [s].
    parameters
        Of the recorder.
    """
    recorder = _start_recorder(folder, **parameters)
    load = _start_load(rate, seconds, farewell)
    try:
        last = _progress_to(load, rate)  # the first second is left out
        begin, used = time.monotonic(), processor_time(recorder.process.pid)
        if stall:
            recorder.process.send_signal(signal.SIGSTOP)
            last = _progress_to(load, min(last["sent"] + stall * rate, rate * seconds))
            recorder.process.send_signal(signal.SIGCONT)
        cpu = math.nan  # of a load that is over within the second that is left out
        while said := _progress(load):
            last = said
            if "elapsed" not in said:
                cpu = (processor_time(recorder.process.pid) - used) / (time.monotonic() - begin)
        load.wait()
        code = recorder.stop()
    finally:
        _end(load)
        recorder.stop()
    if code != 0 or "elapsed" not in last:
        raise LiveError(f"recorder ended with exit code {code}:\n{recorder.last_lines()}")
    recorded = {}
    with BagReader(folder) as bag:
        for topic in LOOP_TOPICS:
            recorded[topic] = count_losses(read_columns(bag, f"/{topic}", ["step"])["step"])
        stored = bag.size / bag.message_count
    if any(steps.count > last["sent"] for steps in recorded.values()):
        raise LiveError("another loop is on this ROS domain; set ROS_DOMAIN_ID to a free one")
    return LoadReport(
        rate,
        last["elapsed"],
        int(last["sent"]),
        recorded,
        reported_losses(recorder.log.read_text(errors="replace")),
        cpu,
        stored,
        last["payload"],
    )


def _start_recorder(folder: Path, **parameters: object) -> NodeProcess:
    folder.mkdir(parents=True)
    options = {"output": folder, **parameters}
    words = [word for name, value in options.items() for word in ("-p", f"{name}:={value}")]
    return NodeProcess("recorder", ["--ros-args", *words], folder / "recorder.log")


def _start_load(rate: float, seconds: float, farewell: float = 10.0) -> TiedProcess:
    options = [str(rate), str(seconds), str(farewell)]
    command = [sys.executable, __file__, *options]
    return TiedProcess(command, stdout=subprocess.PIPE)


def _progress(load: TiedProcess) -> dict[str, float]:
    """Return the next line that a load says; empty at its end."""
    assert load.stdout is not None
    line = load.stdout.readline()
    return dict(json.loads(line)) if line else {}


def _progress_to(load: TiedProcess, steps: float) -> dict[str, float]:
    """Read on until so many steps were sent; return what was said then."""
    last: dict[str, float] = {}
    while last.get("sent", 0) < round(steps) and (said := _progress(load)):
        last = said
    return last


def _end(load: TiedProcess) -> None:
    load.kill()
    load.communicate()


if __name__ == "__main__":
    main(*map(float, sys.argv[1:]))
