"""A rig for commissioning: fast, unstamped, with one knob, or two."""

import math
import random
import threading
import time
from dataclasses import replace

import numpy as np

from koop_tune.rig.rig_file import RigFile
from vdp_plant import dynamics
from vdp_plant.config import PlantConfig

DT = 0.008
TURN = 2.0 * math.pi * 20.0 * DT  # between two samples
BEST, SECOND_BEST = 0.8, 0.1
PATIENCE, COMMANDED = 0.3, 3.0  # [s] for the answer to a sample; since the last command
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
TWO_KNOBS = replace(
    RIG,
    command="/fast/knob:data, /fast/second:data[1]",
    theta_min=(-1.0, 0.0),
    theta_max=(2.0, 0.3),
    theta_rate=(4.0, 0.2),
    theta_start=(1.5, 0.3),
    theta_safe=(-0.8, 0.25),
)


PAPER = RigFile(
    measured="/paper:position[0],position[1]",
    command="/paper/theta:theta[0],theta[1]",
    dt=0.9,
    theta_min=(-4.9, -0.6),
    theta_max=(-1.5, 2.4),
    theta_rate=1.0,
    theta_start=(-1.6, -0.5),
    theta_safe=(-2.0, 0.0),
    constraint="theta[0] + theta[1] <= 0.5",  # a corner is beyond it
    time=1e6,
    pace=300.0,
)
SUBSTEPS, LATE = 10, 0.5  # of a sample; [s] that it makes up for
PLANT = PlantConfig(
    dt=PAPER.dt / SUBSTEPS, theta_star=(-3.0, 1.0), coupling=(0.8, 0.6, -0.3, 0.4),
    epsilon0=0.4, epsilon0_drift=0.0, interference_amplitude_1=0.0, interference_amplitude_2=0.0,
)  # fmt: skip


class Rig:
    """A node in a thread of its own."""

    def __init__(self, name):
        import rclpy
        from rclpy.experimental.events_executor import EventsExecutor

        from koop_node.node.rclpy_internals import WithoutEvents

        self._context = rclpy.Context()
        self._context.init(args=[])
        self._node = WithoutEvents(name, context=self._context)
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def close(self):
        self._over.set()
        self._thread.join()
        self._executor.remove_node(self._node)
        self._node.destroy_node()
        self._executor.shutdown()
        self._context.try_shutdown()


class PaperRig(Rig):
    """The paper's plant with two knobs behind a standard message, faster than real time.

    It is stamped by its own clock and waits for the command that bears the stamp of its sample,
    though not for long, and not where nobody commands: a busy machine makes
    it slow, not another rig. Less damping makes it settle soon, and without drift and interference
    short holds do.
    """

    def __init__(self):
        from koop_msgs.msg import ControlInput
        from sensor_msgs.msg import JointState

        super().__init__("paper_rig")
        self.theta, self._heard = np.array(PAPER.theta_start), -math.inf
        self.most = -math.inf  # of theta[0] + theta[1]
        self._publisher = self._node.create_publisher(JointState, "/paper", 100)
        self._message = JointState()
        self._is_answered = True
        self._node.create_subscription(ControlInput, "/paper/theta", self._on_command, 10)
        self._thread.start()

    def _on_command(self, message):
        self.theta, self._heard = np.array(message.theta), time.monotonic()
        self.most = max(self.most, float(self.theta.sum()))
        self._is_answered |= message.header.stamp == self._message.header.stamp

    def _run(self):
        params, knobs = PLANT.params(), PLANT.knob_params()
        x, y, applied, message = 4.0, 0.0, self.theta.copy(), self._message
        dynamics.advance_knobs(params, knobs, 0, x, y, applied.copy(), self.theta)  # compiles
        k, period, due, said = 0, PAPER.dt / PAPER.pace, time.monotonic(), 0.0
        while not self._over.is_set():
            now = time.monotonic()
            awaited = now < self._heard + COMMANDED and not self._is_answered
            until = max(due, said + PATIENCE) if awaited else due
            if now < until:
                self._executor.spin_once(timeout_sec=until - now)
                continue
            due = max(due + period, now - LATE)  # a busy machine slows it
            for _ in range(SUBSTEPS):
                x, y = dynamics.advance_knobs(params, knobs, k, x, y, applied, self.theta)
                k += 1
            stamp = message.header.stamp
            stamp.sec, stamp.nanosec = divmod(round(k * PLANT.dt * 1e9), 10**9)
            message.position = dynamics.measure(params, k, x, y)
            said, self._is_answered = time.monotonic(), False
            self._publisher.publish(message)


class FastRig(Rig):
    """Oscillates at 20 Hz; its amplitude follows 0.3 + (theta - 0.8)^2 within 0.1 s.

    With another ``dt`` it is slower, but for its amplitude: 6.25 samples are a period.

    The second channel moves half as far as the first: were they equal, their norm would not
    oscillate, and a raw cost would be blind to them.

    With a second knob a^2 + a b + b^2 takes the place of a^2 = (theta - 0.8)^2, where b is ten
    times what the second knob is from 0.1: the two are coupled. It then waits for the answer to
    each sample, though not for long: a busy machine makes it slow, not another rig.

    Its effort, +-exp(2 (worn - theta)), is the larger, the smaller theta is; its rms over a window
    does not depend on the number of samples that a busy machine leaves in it.

    Attributes
    ----------
    theta : float
        Commanded last.
    moved : list of (float, float)
        Every command with its time [s].
    age : int
        Samples since the last command: on a machine that stands still, there are none.
    silences : list of (float, int)
        Of each command but the last, theta and how many samples it was the last one for.
    second : float or None
        The second knob; None: it has none.
    size : float
        Amplitude of the oscillation.
    pairs : list of (float, float)
        Both knobs at every command of the second one.
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

    def __init__(self, two_knobs=False, dt=DT):
        from std_msgs.msg import Float64, Float64MultiArray

        super().__init__("fast_rig")
        self._dt = dt
        self.theta, self.moved = RIG.theta_start, []
        self.second: float | None = None
        self.size, self.pairs = 1.0, []
        self.age, self.silences = 0, []
        self._due = 0.0
        self.applied, self.silent, self.spike = True, False, False
        self.dead: int | None = None
        self.not_finite = False
        self.worn, self.louder = 0.0, 1.0
        self.time_out: float | None = None
        self._message = Float64MultiArray()
        self._publisher = self._node.create_publisher(Float64MultiArray, "/fast", 100)
        self._effort = self._node.create_publisher(Float64, "/fast/effort", 100)
        self._node.create_subscription(Float64, "/fast/knob", self._on_command, 10)
        if two_knobs:
            self.second = TWO_KNOBS.theta_start[1]
            kind, topic = Float64MultiArray, "/fast/second"
            self._node.create_subscription(kind, topic, self._on_second, 10)
        self._thread.start()

    def _on_command(self, message):
        if self.moved:
            self.silences.append((self.moved[-1][1], self.age))
        self.theta, self.age = message.data, 0
        self.moved.append((time.monotonic(), message.data))

    def _on_second(self, message):
        self.second, self._due = message.data[1], 0.0
        self.pairs.append((self.theta, self.second))

    def _run(self):
        from std_msgs.msg import Float64

        rng, k, due = random.Random(0), 0, time.monotonic()
        while not self._over.is_set():
            self._executor.spin_once(timeout_sec=max(max(due, self._due) - time.monotonic(), 0.0))
            if time.monotonic() < max(due, self._due):
                continue
            due = max(due + self._dt, time.monotonic() - LATE)
            if self.second is not None:
                due = time.monotonic() + self._dt
                self._due = due + PATIENCE
            k += 1
            self.age += 1
            silent = time.monotonic() - self.moved[-1][0] if self.moved else 0.0
            if self.time_out is not None and silent > self.time_out:
                self.theta = RIG.theta_safe
            a = (self.theta if self.applied else 1.5) - BEST
            aim = 0.3 + a**2
            if self.second is not None:
                b = 10.0 * (self.second - SECOND_BEST)
                aim = 0.3 + a**2 + a * b + b**2
            self.size += self._dt / 0.03 * (aim - self.size)
            x = self.size * math.sin(TURN * k) + rng.gauss(0.0, 0.05)
            y = 0.5 * self.size * math.cos(TURN * k) + rng.gauss(0.0, 0.05)
            said = [99.0 if self.spike else self.louder * x, y]
            if self.dead is not None:
                said[self.dead] = 0.5
            if self.not_finite:
                said[0] = math.nan
            self._message.data = said
            if not self.silent:
                effort = math.exp(2.0 * (self.worn - self.theta))
                self._effort.publish(Float64(data=effort * (-1) ** k))
                self._publisher.publish(self._message)
