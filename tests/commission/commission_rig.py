"""A rig for commissioning: fast, unstamped, with one knob."""

import math
import random
import threading
import time

from koop_tune.rig.rig_file import RigFile

DT = 0.004
OMEGA = 2.0 * math.pi * 20.0
BEST = 0.8
TYPES = ("std_msgs/msg/Float64MultiArray", "std_msgs/msg/Float64")  # measured, command
RIG = RigFile(
    measured="/fast:data[0],data[1]",
    command="/fast/knob:data",
    dt=DT,
    theta_min=-1.0,
    theta_max=2.0,
    theta_rate=20.0,
    theta_start=1.5,
    theta_safe=1.0,
    channel_max=(8.0, 8.0),
    time=120.0,
)


class FastRig:
    """Oscillates at 20 Hz; its amplitude follows 0.3 + (theta - 0.8)^2 within 0.1 s.

    Its effort, of rms exp(2 (worn - theta)), is the larger, the smaller theta is.

    Attributes
    ----------
    theta : float
        Commanded last.
    moved : list of (float, float)
        Every command with its time [s].
    applied, silent, spike : bool
        Whether theta has an effect, the rig says nothing, the first channel is beyond all limits.
    dead : int or None
        Channel that does not change.
    not_finite : bool
        Whether the first channel is not a number.
    worn : float
        By how much more theta the same effort needs.
    louder : float
        Factor of the first channel.
    time_out : float or None
        Time without a command [s] after which it returns theta by itself.
    """

    def __init__(self):
        import rclpy
        from rclpy.experimental.events_executor import EventsExecutor
        from std_msgs.msg import Float64, Float64MultiArray

        from koop_node.node.entities import WithoutEvents

        self.theta, self.moved = RIG.theta_start, []
        self.applied, self.silent, self.spike = True, False, False
        self.dead: int | None = None
        self.not_finite = False
        self.worn, self.louder = 0.0, 1.0
        self.time_out: float | None = None
        self._context = rclpy.Context()
        self._context.init(args=[])
        self._node = WithoutEvents("fast_rig", context=self._context)
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._message = Float64MultiArray()
        self._publisher = self._node.create_publisher(Float64MultiArray, "/fast", 100)
        self._effort = self._node.create_publisher(Float64, "/fast/effort", 100)
        self._node.create_subscription(Float64, "/fast/knob", self._on_command, 10)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def close(self):
        self._over.set()
        self._thread.join()
        self._executor.remove_node(self._node)
        self._node.destroy_node()
        self._executor.shutdown()
        self._context.try_shutdown()

    def _on_command(self, message):
        self.theta = message.data
        self.moved.append((time.monotonic(), message.data))

    def _run(self):
        from std_msgs.msg import Float64

        rng, size, k, due = random.Random(0), 1.0, 0, time.monotonic()
        while not self._over.is_set():
            self._executor.spin_once(timeout_sec=max(due - time.monotonic(), 0.0))
            if time.monotonic() < due:
                continue
            due += DT
            k += 1
            silent = time.monotonic() - self.moved[-1][0] if self.moved else 0.0
            if self.time_out is not None and silent > self.time_out:
                self.theta = RIG.theta_safe
            aim = 0.3 + ((self.theta if self.applied else 1.5) - BEST) ** 2
            size += DT / 0.03 * (aim - size)
            x = size * math.sin(OMEGA * k * DT) + rng.gauss(0.0, 0.05)
            y = size * math.cos(OMEGA * k * DT) + rng.gauss(0.0, 0.05)
            said = [99.0 if self.spike else self.louder * x, y]
            if self.dead is not None:
                said[self.dead] = 0.5
            if self.not_finite:
                said[0] = math.nan
            self._message.data = said
            if not self.silent:
                effort = math.sqrt(2.0) * math.exp(2.0 * (self.worn - self.theta))
                self._effort.publish(Float64(data=effort * math.sin(OMEGA * k * DT)))
                self._publisher.publish(self._message)
