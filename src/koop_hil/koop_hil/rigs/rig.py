#!/usr/bin/env python3
"""A stand-in for hardware: a rig on Eclipse Cyclone DDS that shares no code with the nodes.

It measures at its own pace with its own clock, and its actuator is late and slow:

    python rig.py galloping --scale 4 --duration 300

It knows nothing of ROS but the names and types on the wire. It waits until somebody listens to its
state, and says when the time is over.
"""

import argparse
import math
import os
import random
import signal
import sys
import threading
import time
from collections import deque
from dataclasses import dataclass

# On loopback, with peers found by unicast: nothing leaves the machine.
os.environ.setdefault(
    "CYCLONEDDS_URI",
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo'/></Interfaces>"
    "<AllowMulticast>spdp</AllowMulticast></General><Discovery><ParticipantIndex>auto"
    "</ParticipantIndex><MaxAutoParticipantIndex>60</MaxAutoParticipantIndex>"
    "<Peers><Peer Address='localhost'/></Peers></Discovery></Domain></CycloneDDS>",
)

try:
    from cyclonedds.core import Policy, Qos
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.idl import IdlStruct
    from cyclonedds.idl.types import float64, int8, int32, int64, sequence, uint32, uint64
    from cyclonedds.pub import DataWriter
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration
except ImportError as error:
    raise SystemExit(f"rig: {error}: pip install cyclonedds") from None
from physics import RIGS, Rig, advance

DT = 0.005  # [s] sampling time of every rig


@dataclass
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    stamp: Time
    frame_id: str


@dataclass
class MeasuredState(IdlStruct, typename="koop_msgs.msg.dds_.MeasuredState_"):
    header: Header
    step: uint64
    lockstep: bool  # a rig waits for nobody: False
    x: sequence[float64]


@dataclass
class ControlInput(IdlStruct, typename="koop_msgs.msg.dds_.ControlInput_"):
    header: Header
    step: uint64
    theta: float64
    epsilon: int8
    cost_rise_filtered: float64
    saturated: bool
    holding: bool
    swing: float64
    gradient: float64
    noise: float64
    confidence: float64


@dataclass
class PlantTruth(IdlStruct, typename="koop_msgs.msg.dds_.PlantTruth_"):
    header: Header
    step: uint64
    x: sequence[float64]
    theta_applied: float64
    theta_step: int64
    epsilon0: float64


class Actuator:
    """Follows the command late, no faster than it can, within its stroke."""

    def __init__(self, theta: float, delay: float, rate: float) -> None:
        self.theta, self.step = theta, -1
        self._commands = deque([(theta, -1)] * (round(delay / DT) + 1))
        self._most = rate * DT

    def move(self, command: float, step: int) -> float:
        """Return theta for the next step, given a command and the step that it answers."""
        self._commands.append((min(max(command, -5.0), 5.0), step))
        wanted, self.step = self._commands.popleft()
        change = wanted - self.theta
        self.theta += min(max(change, -self._most), self._most)
        return self.theta


def measure(rig: Rig, t: float, state: tuple[float, float], rng: random.Random) -> list[float]:
    """Return what the sensors say."""
    added = rig.disturbance(t)
    noisy = (value + added + rng.gauss(0.0, rig.noise) for value in state)
    return [round(value / rig.resolution) * rig.resolution for value in noisy]


def options() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rig", choices=sorted(RIGS))
    parser.add_argument(
        "--duration", type=float, default=0.0, help="simulated seconds; 0: no limit"
    )
    parser.add_argument("--scale", type=float, default=1.0, help="simulated per real time")
    parser.add_argument("--state", default="state", help="topic of the measured state")
    parser.add_argument("--theta", default="theta", help="topic of the command")
    parser.add_argument("--theta-initial", type=float, default=2.0)
    parser.add_argument("--drift", type=float, default=200e-6, help="of the rig's clock [s/s]")
    parser.add_argument("--jitter", type=float, default=0.1, help="of every period [periods]")
    parser.add_argument("--delay", type=float, default=0.02, help="of the actuator [s]")
    parser.add_argument("--rate", type=float, default=1.0, help="of the actuator [1/s]")
    parser.add_argument(
        "--theta-timeout", type=float, default=0.5, help="age of the state behind a command [s]"
    )
    parser.add_argument("--readers", type=int, default=1, help="of the state to wait for")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--until-eof", action="store_true", help="end when stdin is closed")
    return parser.parse_args()


def main() -> int:
    """Run the rig; return the exit code."""
    args, rig = options(), None
    rig, rng, stop = RIGS[args.rig], random.Random(args.seed), []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.append(True))
    if args.until_eof:  # nobody writes to it: a read returns when who started the rig has ended
        threading.Thread(target=lambda: stop.append(os.read(0, 1)), daemon=True).start()
    participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
    qos = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(1000))
    states = DataWriter(participant, Topic(participant, "rt/" + args.state, MeasuredState), qos)
    ground_truths = DataWriter(participant, Topic(participant, "rt/ground_truth", PlantTruth), qos)
    newest = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(1))
    thetas = DataReader(participant, Topic(participant, "rt/" + args.theta, ControlInput), newest)
    while len(states.get_matched_subscriptions()) < args.readers and not stop:
        time.sleep(0.02)
    print("connected", flush=True)

    actuator = Actuator(args.theta_initial, args.delay, args.rate)
    command, answered, state, k = args.theta_initial, -1, rig.start, 0
    period = DT / args.scale * (1.0 + args.drift)
    oldest = args.theta_timeout * args.scale / DT  # [steps]
    steps = round(args.duration / DT) if args.duration else math.inf
    started = time.monotonic()
    wall = time.time()
    while k < steps and not stop:
        due = started + (k + args.jitter * rng.random()) * period
        now = time.monotonic()
        if now < due:
            time.sleep(due - now)
        elif now > due + 1.0:  # was stopped or starved: time goes on from here
            started += now - due
        t = k * DT
        # the rig's own clock: its start is real time, its seconds are a little too long
        stamp = round((wall + t) * 1e9)
        header = Header(Time(stamp // 10**9, stamp % 10**9), "rig")
        states.write(MeasuredState(header, k, False, measure(rig, t, state, rng)))
        ground_truths.write(
            PlantTruth(header, k, list(state), actuator.theta, actuator.step, math.nan)
        )
        for sample in thetas.take(N=100):
            known = isinstance(sample, ControlInput) and math.isfinite(sample.theta)
            if known and 0 <= k - sample.step <= oldest:  # not what was kept while a link was cut
                command, answered = sample.theta, sample.step
        state = advance(rig, t, DT, state, actuator.move(command, answered))
        if not math.isfinite(state[0] + state[1]):
            print(f"the rig broke at t = {t:g} s", file=sys.stderr)
            return 1
        k += 1
    time.sleep(0.2)  # a reliable writer's last samples are still on their way
    print(f"{k} steps in {time.monotonic() - started:.2f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
