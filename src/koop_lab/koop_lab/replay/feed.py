"""Replay through the real nodes: plays the recorded states to lifter and controller in lockstep.

The next state goes out when the theta for the last one has come back, so that the result does not
depend on the machine's speed. The states go out as the bytes that were recorded.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from koop_bag.bag.reader import BagReader
from koop_bringup.live.process import START_TIMEOUT, NodeProcess, uninterrupted
from koop_bringup.live.turns import taking_turns_with
from koop_core.config import parameter_file
from koop_core.errors import LiveError
from koop_core.stream.resend import Due, Resend
from koop_identify.recording.recorded_parameters import CONTROLLER
from koop_lab.replay.plan import ReplayPlan, ReplaySegment
from koop_lab.replay.recording import Recording
from koop_loop.parameters import COMPONENTS
from koop_node.client.client import Client
from koop_node.node.wire import codec
from koop_node.process.domain import free_domain

FEEDER = "koop_replay"
TIMEOUT = 5.0  # [s] without an answer after which a state is sent again; a node that lives answers
RESENDS = 2


def replay_live(
    recording: Recording, plan: ReplayPlan
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Replay a recording through the nodes, in a process of theirs, over DDS.

    Returns
    -------
    r, theta : ndarray, shape (M,)
        What lifter and controller answer.

    Raises
    ------
    koop_core.errors.LiveError
        If a node ends, does not answer or refuses a parameter.
    """
    if plan.segments[0].parameters.lifter.constraint:
        raise LiveError("the signal of a constraint is not played to the nodes: add --offline")
    with tempfile.TemporaryDirectory(prefix="koop-replay-") as name:
        components = [COMPONENTS[node] for node in reversed(CONTROLLER)]
        arguments = ["--ros-args", "--params-file", str(_parameter_file(Path(name), plan))]
        domain = free_domain()
        nodes = NodeProcess(
            "container",
            [*components, *arguments],
            Path(name) / "nodes.log",
            environment={**os.environ, "ROS_DOMAIN_ID": str(domain)},
        )
        try:
            with Feeder(nodes, domain) as feeder:
                return feeder.run(recording, plan)
        finally:
            with uninterrupted():
                nodes.stop()


def _parameter_file(folder: Path, plan: ReplayPlan) -> Path:
    by_node = plan.segments[0].parameters.as_ros()
    # the lifter starts to listen when the controller and the feeder take its cost, the controller
    # when the feeder takes its theta
    values = {node: {**by_node[node], "listeners": f"next {FEEDER}"} for node in CONTROLLER}
    values["relay_esc"]["listeners"] = FEEDER
    file = folder / "parameters.yaml"
    parameter_file.write(values, file)
    return file


class Feeder(Client):
    """The plant's place in the loop, taken by a recording."""

    def __init__(self, nodes: NodeProcess, domain: int) -> None:
        from koop_msgs.msg import ControlInput, Cost, MeasuredState
        from rclpy.qos import QoSProfile

        super().__init__(FEEDER, domain, udp=False)  # a fifth faster
        self._nodes = nodes
        qos = QoSProfile(depth=100)
        self._publisher = self.node.create_publisher(MeasuredState, "state", qos)
        self._read_cost, self._read_theta = codec(Cost).decode, codec(ControlInput).decode
        self.node.create_subscription(Cost, "cost", self._on_cost, qos, raw=True)
        self.node.create_subscription(ControlInput, "theta", self._on_theta, qos, raw=True)
        self._question = Resend(TIMEOUT, RESENDS)
        self._cost: tuple[int, float] | None = None
        self._theta: tuple[int, Sequence[float]] | None = None

    def run(
        self, recording: Recording, plan: ReplayPlan
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Play all states and return the answers r, theta."""
        self.wait_for(
            self._publisher.get_subscription_count,
            START_TIMEOUT,
            "the lifter to listen",
            self._check_nodes,
        )
        if max(self.node.count_publishers(topic) for topic in ("state", "cost", "theta")) > 1:
            raise LiveError("another loop has joined the ROS domain of the replay: try again")
        with taking_turns_with(self._nodes.process.pid):
            return self._play(recording, plan)

    def _play(
        self, recording: Recording, plan: ReplayPlan
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        size = recording.step.size
        n = plan.segments[0].parameters.esc.count
        r, theta = np.empty(size), np.empty((size, n))
        begins = {segment.begin: segment for segment in plan.segments[1:]}
        held = False
        for k, message in enumerate(tqdm(_states(recording), total=size, disable=None)):
            if k in begins:
                self._change(begins[k])
            if recording.hold[k] != held:
                held = bool(recording.hold[k])
                self._hold(held)
            if recording.late[k]:  # has no answer
                self._publisher.publish(message)
                r[k], theta[k] = np.nan, np.nan
            else:
                r[k], theta[k] = self._ask(int(recording.step[k]), message)
        return r, theta if n > 1 else theta[:, 0]

    def _on_cost(self, data: bytes) -> None:
        message = self._read_cost(data)
        self._cost = (message.step, message.r)

    def _on_theta(self, data: bytes) -> None:
        message = self._read_theta(data)
        self._theta = (message.step, message.theta)

    def _ask(self, step: int, message: bytes) -> tuple[float, Sequence[float]]:
        """Send a state and return both answers to it."""
        self._cost = self._theta = None
        self._publisher.publish(message)
        self._question.ask(time.monotonic())
        while True:
            cost, theta = self._cost, self._theta
            if cost is not None and theta is not None and cost[0] == theta[0] == step:
                self._question.close()
                return cost[1], theta[1]
            self.spin(0.2)
            self._check_nodes()
            due = self._question.check(time.monotonic())
            if due is Due.AGAIN:
                self._publisher.publish(message)
            elif due is Due.GIVE_UP:
                break
        silent = CONTROLLER[0] if self._cost is None or self._cost[0] != step else CONTROLLER[1]
        raise LiveError(f"{silent} does not answer step {step}:\n{self._nodes.last_lines()}")

    def _change(self, segment: ReplaySegment) -> None:
        """Set parameters as they were set while recording."""
        for change in segment.changed:
            by_name = segment.parameters.as_ros()[change.node]
            values = {name: by_name[name] for name in change.values}
            self.set_parameters(change.node, values, START_TIMEOUT, self._check_nodes)

    def _hold(self, data: bool) -> None:
        from std_srvs.srv import SetBool

        request = SetBool.Request(data=data)
        self.call(SetBool, f"{CONTROLLER[1]}/hold", request, START_TIMEOUT, self._check_nodes)

    def _check_nodes(self) -> None:
        if self._nodes.poll() is not None:
            raise self._nodes.failure()


def _states(recording: Recording) -> Iterator[bytes]:
    """Yield the serialized states of a recording's rows."""
    rows = set(recording.message.tolist())
    with BagReader(recording.path) as bag:
        for number, message in enumerate(bag.messages([recording.state_topic])):
            if number in rows:
                yield message.data
