"""ROS node of the lifter: ``state`` in, ``cost`` out; the model comes from a file."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from koop_msgs.msg import Cost, MeasuredState

from koop_node.adapter import StateAdapter
from koop_node.config import NodeConfig
from koop_node.fields import check_fields
from koop_node.main import run
from koop_node.managed import BEST_EFFORT, OK, RELIABLE, WARN, ManagedNode, message_type
from koop_node.stream import LATE, NEXT, REPEAT, RESTART, StreamMonitor
from koopman_lifter import cost
from koopman_lifter.config import LifterConfig, ModelConfig
from koopman_lifter.model import KoopmanModel, ModelError, load


class LifterNode(ManagedNode):
    """Answers every state with a cost.

    A state that cannot be used (wrong length, not finite) is answered with r = NaN, on which the
    controller holds; the detector goes on with the next usable state. A state that was overtaken
    by a newer one is counted and not answered: the filters can't go back in time.
    """

    def __init__(self) -> None:
        self._candidate: KoopmanModel | None = None
        self._subscription: Any = None
        super().__init__("koopman_lifter", LifterConfig, ModelConfig)

    def configure(self) -> None:
        self._use(self._loaded(self.parameters[ModelConfig].path, self.parameters[LifterConfig]))
        self._answer = Cost()
        self._state = cost.initial()
        config = self.parameters[LifterConfig]
        self._input = StreamMonitor("state", config.state_timeout, config.dt)
        self.inputs = (self._input,)
        self._take_config()
        self._compile()
        self._publisher = self.create_publisher(Cost, "cost", RELIABLE)
        self._adapt(config)
        self.get_logger().info(
            f"model {self._model.model_id}: {self._model.observables.p} observables, "
            f"{self._model.projector.shape[0]} modes kept"
        )

    def activate(self) -> None:
        if self._subscription is None:
            recorders = self.parameters[NodeConfig].recorders
            needed = {self._publisher: 1 + recorders}
            if self._state_publisher is not None:
                needed[self._state_publisher] = recorders
            self.when_matched(needed, self._listen)

    def cleanup(self) -> None:
        if self._subscription is not None:
            self.destroy_subscription(self._subscription)
            self._subscription = None
        self.destroy_publisher(self._publisher)
        if self._state_publisher is not None:
            self.destroy_publisher(self._state_publisher)

    def check_parameters(self, configs: dict[type, Any], names: set[str]) -> None:
        if "model" in names:  # the same path, too: there may be another model in the file by now
            self._candidate = self._loaded(configs[ModelConfig].path, configs[LifterConfig])

    def parameters_changed(self, names: set[str]) -> None:
        if self.lifecycle_state in ("unconfigured", "configuring"):
            return
        if "model" in names and self._candidate is not None:
            self._use(self._candidate)
            self._state = cost.initial()
            self.get_logger().info(f"model is now {self._model.model_id}")
        if "cost" in names:  # another quantity: its difference to the last sample means nothing
            self._state = cost.initial()
        self._take_config()

    def samples(self) -> int:
        return self._input.count if self.inputs else 0

    def diagnose(self) -> tuple[int, str, Mapping[str, object]]:
        if not self.inputs:
            return OK, "", {}
        values = {"cost": self.parameters[LifterConfig].cost, "model_id": self._answer_id}
        if self._input.step is None:
            return OK, "no state yet", values
        early, taken = self._adapter.early if self._adapter else 0, self._input.count
        too_fast = early - self._early > (taken - self._taken) / 2
        self._early, self._taken = early, taken
        values |= {"step": self._answer.step, "r": self._answer.r}
        if too_fast:
            dt = self.parameters[LifterConfig].dt
            return WARN, f"'{self._topic}' is faster than one message in dt = {dt:g} s", values
        return OK, "lifting", values

    def _loaded(self, path: Path, config: LifterConfig) -> KoopmanModel:
        model = load(path)
        if model.dt != config.dt:
            raise ModelError(
                f"{path}: trained at dt = {model.dt} s, this node runs at dt = {config.dt} s; "
                "train a model at that step or set the parameter dt"
            )
        return model

    def _use(self, model: KoopmanModel) -> None:
        self._model = model
        self._lifting = model.lifting()
        self._z = np.empty(model.observables.p)
        self._answer_id = model.model_id

    def _take_config(self) -> None:
        config = self.parameters[LifterConfig]
        self._source = config.source
        self._detector = config.detector_params()
        self._input.timeout = config.state_timeout

    def _adapt(self, config: LifterConfig) -> None:
        """Prepare for a rig that speaks another message than MeasuredState."""
        self._state_publisher: Any = None
        self._adapter: StateAdapter | None = None
        self._early = self._taken = 0
        self._topic, self._type, self._callback = "state", MeasuredState, self._on_state
        if config.foreign is not None:
            self._topic, self._type = config.foreign.topic, message_type(config.input_type)
            check_fields(config.foreign.fields, self._type())
            self._adapter = StateAdapter(config.foreign, config.dt)
            self._callback = self._on_foreign
            self._state_publisher = self.create_publisher(MeasuredState, "state", RELIABLE)
        self._input.topic = self._topic

    def _listen(self) -> None:
        self._subscription = self.create_subscription(
            self._type,
            self._topic,
            self._callback,
            RELIABLE if self._type is MeasuredState else BEST_EFFORT,
        )

    def _on_foreign(self, message: Any) -> None:
        """Publish what a rig measured as 'state', for recording and replay, and answer it."""
        if not self.active or self._adapter is None:
            return
        step, x = self._adapter.convert(message)
        state = MeasuredState(step=step, x=x)
        header = getattr(message, "header", None)
        if isinstance(header, type(state.header)):  # a package may have a header of its own
            state.header = header
        self._state_publisher.publish(state)
        self._on_state(state)

    def _on_state(self, state: MeasuredState) -> None:
        if not self.active:
            return
        stamp = state.header.stamp
        kind = self._input.take(state.step, stamp.sec + 1e-9 * stamp.nanosec, time.monotonic())
        if kind == LATE:
            return
        if kind != REPEAT:  # else it was asked again: the same answer, no second update
            if kind == RESTART:
                self._state = cost.initial()
            elif kind != NEXT:
                self._state = cost.resume(self._state)
            self._process(state)
        self._publisher.publish(self._answer)

    def _process(self, state: MeasuredState) -> None:
        answer = self._answer
        answer.header = state.header
        answer.step = state.step
        answer.source = self._source
        answer.model_id = self._answer_id
        x = np.frombuffer(state.x)
        if x.shape[0] == self._model.observables.n:
            answer.r, answer.y_out, self._state = cost.step(
                self._source, self._lifting, self._detector, self._state, x, self._z
            )
        else:
            answer.r = answer.y_out = math.nan
        if math.isnan(answer.r):
            self._state = cost.resume(self._state)
            self._report_unusable(x)

    def _report_unusable(self, x: np.ndarray[Any, Any]) -> None:
        n = self._model.observables.n
        if x.shape[0] != n:
            problem = f"state has {x.shape[0]} values, the model {self._answer_id} needs {n}"
        else:
            problem = f"state {x.tolist()} is not finite or its y_out too large"
        self._input.reject(f"step {self._answer.step}: {problem}")
        self.get_logger().error(self._input.problem, throttle_duration_sec=1.0)

    def _compile(self) -> None:
        """Compile the kernel for the types that messages bring, before the first sample."""
        x = np.frombuffer(MeasuredState(x=[0.0] * self._model.observables.n).x)
        for state in (cost.initial(), cost.resume(self._state)):
            cost.step(self._source, self._lifting, self._detector, state, x, self._z)


def main() -> None:
    """Run the node until it is told to stop."""
    sys.exit(run(LifterNode))
