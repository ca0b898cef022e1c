"""ROS node of the lifter: ``state`` in, ``cost`` out; the model comes from a file."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from koop_msgs.msg import Cost, MeasuredState

from koop_node.config import NodeConfig
from koop_node.main import run
from koop_node.managed import ERROR, OK, QOS, WARN, ManagedNode
from koopman_lifter import cost
from koopman_lifter.config import LifterConfig, ModelConfig
from koopman_lifter.model import KoopmanModel, ModelError, load


class LifterNode(ManagedNode):
    """Answers every state with a cost.

    A state that cannot be used (wrong length, not finite) is answered with r = NaN, on which the
    controller holds; the detector goes on from the last usable state.
    """

    def __init__(self) -> None:
        self._candidate: tuple[Path, KoopmanModel] | None = None
        self._subscription: Any = None
        self._count = 0
        self._unusable = 0
        self._missed = 0
        self._last_problem = ""
        super().__init__("koopman_lifter", LifterConfig, ModelConfig)

    def configure(self) -> None:
        self._use(self._loaded(self.parameters[ModelConfig].path, self.parameters[LifterConfig]))
        self._answer = Cost()
        self._step: int | None = None
        self._state = cost.initial()
        self._take_config()
        self._compile()
        self._publisher = self.create_publisher(Cost, "cost", QOS)
        self.get_logger().info(
            f"model {self._model.model_id}: {self._model.observables.p} observables, "
            f"{self._model.projector.shape[0]} modes kept"
        )

    def activate(self) -> None:
        if self._subscription is None:
            recorders = self.parameters[NodeConfig].recorders
            self.when_matched({self._publisher: 1 + recorders}, self._listen)

    def cleanup(self) -> None:
        if self._subscription is not None:
            self.destroy_subscription(self._subscription)
            self._subscription = None
        self.destroy_publisher(self._publisher)

    def check_parameters(self, configs: dict[type, Any]) -> None:
        path = configs[ModelConfig].path
        if path != self.parameters[ModelConfig].path:
            self._candidate = (path, self._loaded(path, configs[LifterConfig]))

    def parameters_changed(self, names: set[str]) -> None:
        if self.lifecycle_state in ("unconfigured", "configuring"):
            return
        if "model" in names and self._candidate is not None:
            self._use(self._candidate[1])
            self._state = cost.initial()
            self.get_logger().info(f"model is now {self._model.model_id}")
        if "cost" in names:  # another quantity: its difference to the last sample means nothing
            self._state = cost.initial()
        self._take_config()

    def samples(self) -> int:
        return self._count

    def diagnose(self) -> tuple[bytes, str, Mapping[str, object]]:
        if self._count == 0:
            return OK, "no state yet", {}
        values = {
            "step": self._step,
            "r": self._answer.r,
            "model_id": self._model.model_id,
            "missed_steps": self._missed,
            "unusable_states": self._unusable,
        }
        if math.isnan(self._answer.r):
            return ERROR, self._last_problem, values
        return (WARN, "missed states", values) if self._missed else (OK, "lifting", values)

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

    def _listen(self) -> None:
        self._subscription = self.create_subscription(MeasuredState, "state", self._on_state, QOS)

    def _on_state(self, state: MeasuredState) -> None:
        if not self.active:
            return
        step = state.step
        if step != self._step:
            self._process(state, step)
        # a repeated step was asked again: the same answer, no second update
        self._publisher.publish(self._answer)

    def _process(self, state: MeasuredState, step: int) -> None:
        if self._step is not None:
            if step < self._step:
                self.get_logger().warning(f"step went back from {self._step} to {step}")
                self._state = cost.initial()
            else:
                self._missed += step - self._step - 1
        self._step = step
        self._count += 1
        answer = self._answer
        answer.header = state.header
        answer.step = step
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
            self._report_unusable(x, step)

    def _report_unusable(self, x: np.ndarray[Any, Any], step: int) -> None:
        self._unusable += 1
        n = self._model.observables.n
        if x.shape[0] != n:
            problem = f"state has {x.shape[0]} values, the model {self._answer_id} needs {n}"
        else:
            problem = f"state {x.tolist()} is not finite or too large"
        self._last_problem = f"step {step}: {problem}"
        self.get_logger().error(self._last_problem, throttle_duration_sec=1.0)

    def _compile(self) -> None:
        """Compile the kernel for the types that messages bring, before the first sample."""
        x = np.frombuffer(np.zeros(self._model.observables.n).tobytes())
        for state in (cost.initial(), self._state):
            cost.step(self._source, self._lifting, self._detector, state, x, self._z)


def main() -> None:
    """Entry point of ``ros2 run koopman_lifter lifter``."""
    sys.exit(run(LifterNode))
