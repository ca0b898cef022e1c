#!/usr/bin/env python3
"""The rig of ``koop hil chaos``: a galloping prism on standard messages, whose sensors fail.

    python faulty.py LOG

A line on stdin begins a fault or ends it: ``nan 1``, ``nan 0``; the rig ends with its stdin. It
has what every rig should have, a time-out of its own: without a command for TIMEOUT theta returns
to SAFE. The log has a line for each sample: time [s], stamp [ns], theta, command or nan, time
without a command [s], x.
"""

import math
import random
import sys
import threading
import time

from oscillator import DT, RIGS, advance
from stand import Actuation, Actuator
from wire import Wire

LOW, HIGH, SAFE, START, RATE = -3.0, 4.0, 2.0, 2.0, 4.0  # of theta; as the guard is told
LIMIT = 50.0  # of each channel, as the guard is told; the rig itself stays within 6
TIMEOUT = 20.0  # [s], longer than the guard's twin needs to find out that the guard was stopped
LEAP, LATE, STEP = 3600.0, 0.3, 0.5  # a clock's jump [s], a delay [s], a coarse sensor's step


class Sensors:
    """Readings of the true state by sensors with faults."""

    def __init__(self, seed: int) -> None:
        self.faults: set[str] = set()
        self._random = random.Random(seed)
        self._last = [0.0, 0.0]

    def measure(self, x: tuple[float, float]) -> list[float]:
        """Return the channels."""
        values = [round(value + self._random.gauss(0.0, 0.02), 2) for value in x]
        if "stuck" in self.faults:
            values[0] = self._last[0]
        if "biased" in self.faults:
            values[1] += 1.0
        if "quantised" in self.faults:
            values = [round(value / STEP) * STEP for value in values]
        self._last = values
        if "spiking" in self.faults and self._random.random() < 0.05:
            values = [values[0], 2.0 * LIMIT]
        if "nan" in self.faults:
            values = [math.nan, values[1]]
        return values

    def copies(self) -> int:
        """Return how often a sample is sent."""
        if self.faults & {"dead", "cut"} or (
            "lossy" in self.faults and self._random.random() < 0.3
        ):
            return 0
        return 2 if "doubled" in self.faults else 1


def main(log: str) -> None:
    """Run until stdin ends."""
    wire, sensors = Wire("rig/state", ["rig/theta"], "JointState", False), Sensors(1)
    actuator = Actuator(Actuation(START, LOW, HIGH, 0.0, RATE), DT)
    ended = threading.Event()

    def listen() -> None:
        for line in sys.stdin:
            name, on = line.split()
            (sensors.faults.add if on == "1" else sensors.faults.discard)(name)
        ended.set()

    threading.Thread(target=listen, daemon=True).start()
    physics = RIGS["galloping"]
    x, command, heard, k = physics.start, START, time.monotonic(), 0
    begin, late = time.monotonic(), []
    with open(log, "a", buffering=1 << 14) as file:
        while not ended.is_set():
            time.sleep(max(0.0, begin + k * DT - time.monotonic()))
            if time.monotonic() > begin + k * DT + 1.0:  # was stopped: time goes on from here
                begin = time.monotonic() - k * DT
            now = time.time()
            stamp = round((now + LEAP * ("clock" in sensors.faults)) * 1e9)
            late.append((now + LATE * ("delayed" in sensors.faults), stamp, sensors.measure(x)))
            while late and late[0][0] <= now:
                _, at, values = late.pop(0)
                for _ in range(sensors.copies()):
                    wire.say(at, k, values, [], [], 0)
            said = math.nan
            for _, wanted, _ in wire.heard() if "cut" not in sensors.faults else ():
                command = said = wanted
                heard = time.monotonic()
            silent = time.monotonic() - heard
            theta = actuator.move(SAFE if silent > TIMEOUT else command, 0)
            file.write(f"{now:.6f},{stamp},{theta:.9g},{said:.12g},{silent:.3f},{x[0]:.4g}\n")
            x = advance(physics, k * DT, DT, x, theta)
            k += 1


if __name__ == "__main__":
    main(sys.argv[1])
