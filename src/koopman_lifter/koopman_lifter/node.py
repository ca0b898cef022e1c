"""ROS node of the lifter: ``state`` in, ``cost`` out; the model comes from a file."""

from __future__ import annotations

import math
import time
from array import array
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from koop_msgs.msg import Cost, MeasuredState
from numpy.typing import NDArray
from rclpy.parameter import Parameter

from koop_core.config.constraint import Constraint
from koop_core.config.fields import Source, read_field
from koop_core.config.parameter import ListenersConfig
from koop_core.errors import InputError
from koop_core.kernels import direct
from koop_core.port import NO_PORT
from koop_core.stream.arrival import Arrival, timeout_of
from koop_core.stream.monitor import StreamMonitor
from koop_node.node.adapter import StateAdapter
from koop_node.node.entities import Writer
from koop_node.node.graph import listeners_of, publishers_of
from koop_node.node.managed import OK, WARN, Entities, ManagedNode, Run, message_type
from koop_node.node.qos import BEST_EFFORT, RELIABLE
from koop_node.node.stamps import to_seconds
from koop_node.node.wire import codec
from koopman_lifter import candidate, cost, margin
from koopman_lifter.change import Change, Watch
from koopman_lifter.config import LifterConfig, ModelConfig, shipped_model
from koopman_lifter.model import KoopmanModel, load_fitting, load_for
from koopman_lifter.search import Search
from koopman_lifter.stage import (
    CHANGED,
    COST,
    STATE,
    UNUSABLE,
    LifterProgress,
    LifterStage,
    answer_next,
)


class LoadedModel:
    """A model as the kernel takes it; without one, what the raw cost takes in its place."""

    def __init__(self, model: KoopmanModel | None) -> None:
        self.model = model
        self.n = model.delays.channels if model is not None else 0  # any
        self.id = model.model_id if model is not None else ""
        self.lifting = model.lifting() if model is not None else cost.no_lifting()
        self.work = cost.workspace(self.lifting)


class ForeignSource(StateAdapter):
    """A rig that speaks another message than MeasuredState."""

    def __init__(self, source: Source, dt: float) -> None:
        super().__init__(source, dt)
        self.topic = source.topic
        self.publisher: Writer | None = None  # of 'state', while the node is active
        self._before = (0, 0)  # early and taken

    def publish(self, message: Any) -> MeasuredState:
        """Publish what the rig measured as 'state', for recording and replay, and return it."""
        step, x = self.convert(message)
        state = MeasuredState(step=step, x=x)
        header = getattr(message, "header", None)
        if isinstance(header, type(state.header)):  # a package may have a header of its own
            state.header = header
        if self.publisher is not None:
            self.publisher.publish(state)
        return state

    def too_fast(self, taken: int) -> bool:
        """Return whether most messages since the last call came much sooner than a step."""
        (early, before), self._before = self._before, (self.early, taken)
        return self.early - early > (taken - before) / 2


class BoundedSignal:
    """The signal of a constraint, and the margin that it leaves."""

    def __init__(self, constraint: Constraint, dt: float) -> None:
        self._source = constraint.source
        self._meter = margin.SignalMeter(constraint, dt)
        self._params, self._state = margin.margin_params(constraint, dt), margin.BEGIN
        self._follow = direct(margin.follow, self._params, self._state, 0, 0.0, 0.0)

    def listen(self, entities: Entities, then: Callable[[], object]) -> None:
        """Hear the signal once it is published, and ``then`` go on."""

        def listen_to(name: str) -> None:
            kind = message_type(name, self._source.fields)
            entities.subscription(kind, self._source.topic, self._hear, BEST_EFFORT)
            then()

        entities.when_typed(publishers_of, self._source.topic, listen_to)

    def _hear(self, message: Any) -> None:
        self._meter.hear(read_field(self._source.fields[0], message))

    def follow(self, arrival: int) -> float:
        """Return the margin at the next state; NaN where it is not known."""
        left, self._state = self._follow(self._params, self._state, arrival, *self._meter.take())
        return left


class Trial(NamedTuple):
    """A new model on trial: the file of the one before, the oscillation [Hz] and samples of it."""

    before: Path
    frequency: float
    samples: candidate.Samples


class LifterRun(Run):
    """A lifter with its model, if it has one, from the first state on."""

    def __init__(self, node: LifterNode, entities: Entities) -> None:
        config = node.parameters[LifterConfig]
        self._node = node
        source = config.rig_source
        self._foreign = None if source is None else ForeignSource(source, config.dt)
        self._seen = 0 if source is None else len(source.fields)
        self._candidate: KoopmanModel | None = None
        self._change: Change | None = None
        self._search: Search | None = None
        self._trial: Trial | None = None
        self._source, self._detector = config.source, config.detector_params()
        self._answer = codec(Cost).new()
        self._answer.dt, self._answer.margin = config.dt, math.nan
        self._use(load_for(config, node.parameters[ModelConfig], self._seen))
        self._state = cost.initial()
        bounded = config.bounded
        self._signal = None if bounded is None else BoundedSignal(bounded, config.dt)
        self._topic = "state" if source is None else source.topic
        self._input = StreamMonitor(self._topic, timeout_of(config.dt), config.dt, may_end=True)
        self.inputs = (self._input,)
        self._publisher: Writer | None = None

    def activate(self, entities: Entities) -> None:
        follower, observers = listeners_of(self._node.parameters[ListenersConfig].listeners, "loop")
        writer = self._publisher = entities.writer(Cost, "cost", RELIABLE)
        needed = {writer.publisher: follower}
        foreign = self._foreign
        if foreign is not None:
            foreign.publisher = entities.writer(MeasuredState, "state", RELIABLE)
            needed[foreign.publisher.publisher] = observers

        def listen() -> None:
            if foreign is None:
                self.reader = entities.reader(MeasuredState, "state", self._on_state, RELIABLE)
            else:
                entities.when_typed(publishers_of, foreign.topic, listen_to)

        def listen_to(name: str) -> None:
            assert foreign is not None
            kind = message_type(name, foreign.fields)
            qos = RELIABLE if kind is MeasuredState else BEST_EFFORT
            entities.dated_subscription(kind, foreign.topic, self._on_foreign, qos)

        signal = self._signal
        ready = listen if signal is None else partial(signal.listen, entities, listen)
        entities.when_heard(needed, ready)

    def deactivate(self) -> None:
        self._input.pause()
        self._end_search()
        self._publisher = self.reader = None
        if self._foreign is not None:
            self._foreign.publisher = None

    def check_parameters(self, configs: dict[type, Any], names: set[str]) -> None:
        self._candidate, config = None, configs[LifterConfig]
        needed = config.cost == "lifted" and self._loaded.model is None
        if "model" in names or needed:  # the same path, too: the file may have another by now
            self._candidate = load_fitting(configs[ModelConfig].path, config.dt, self._seen)

    def parameters_changed(self, names: set[str]) -> None:
        if self._candidate is not None:
            self._use(self._candidate)
            self._candidate = None
        config = self._node.parameters[LifterConfig]
        self._source, self._detector = config.source, config.detector_params()
        if config.adapt == "never" and self._trial is None:
            self._end_search()
        if {"cost", "model"} & names:  # of another quantity the filters know nothing
            self._state = cost.joining(self._detector)
            self._loaded.work = cost.workspace(self._loaded.lifting)
        if {"cost", "model", "begin"} & names:
            self._begin_watch(self._watch.channels)

    def samples(self) -> int:
        return self._input.count

    def diagnose(self) -> tuple[int, str, Mapping[str, object]]:
        config = self._node.parameters[LifterConfig]
        values: dict[str, object] = {"cost": config.cost, "model_id": self._loaded.id}
        if self._input.step is None:
            return OK, "no state yet", values
        self._note(self._watch.look())
        if self._change is not None and config.adapt != "never":
            self._seek_model()
        if self._trial is not None and self._kept.full:
            self._judge(self._trial)
        if (frequency := self._watch.frequency) is not None:
            values["frequency"] = frequency
        values |= {"step": self._answer.step, "r": self._answer.r}
        if self._signal is not None:
            values["margin"] = self._answer.margin
        if self._foreign is not None and self._foreign.too_fast(self._input.count):
            text = f"'{self._topic}' is faster than one message in dt = {config.dt:g} s"
            return WARN, text, values
        if self._trial is not None:
            return WARN, "the rig has changed: a new model is on trial", values
        if wait := self._filling():
            text = f"no cost until {wait * config.dt:.1f} s more fill the delay line"
            return OK, text, values
        if self._state.settling:
            left = self._state.settling * config.dt
            return OK, f"joined a run: no cost until the filters settle in {left:.1f} s", values
        if self._change is not None:
            if self._proposed:
                values["proposed_model"] = self._proposed
                text = (
                    f"{self._change}; a better model is proposed: set 'model' to {self._proposed}"
                )
                return WARN, text, values
            return WARN, str(self._change), values
        return OK, "lifting", values

    def _on_foreign(self, message: Any, written: float) -> None:
        if self._foreign is not None:
            self._on_state(self._foreign.publish(message), written)

    def _on_state(self, state: Any, written: float) -> None:
        arrival = self._input.hear_message(state, time.monotonic(), written)
        if arrival >= Arrival.LATE or self._publisher is None:
            return
        if arrival is Arrival.REPEAT:  # asked again: the same answer, no second update
            self._publisher.publish(self._answer)
            return
        x = self._process(state, arrival)
        self._publisher.publish(self._answer)
        if not self._answer.y_out > self._detector.y_max:
            self._keep(self._kept, state.step, x)
            self._observe(x)

    def _process(self, state: Any, arrival: Arrival) -> NDArray[np.float64]:
        answer = self._answer
        answer.header = state.header
        answer.step = state.step
        answer.lockstep = state.lockstep
        answer.source = self._source
        x = self._taken(np.frombuffer(state.x), arrival)
        loaded = self._loaded
        answer.model_id = loaded.id
        answer.r, answer.y_out, answer.settling, self._state = self._kernel(
            self._source, loaded.lifting, self._detector, self._state, int(arrival), state.step,
            x, loaded.work,
        )  # fmt: skip
        if self._signal is not None:
            answer.margin = self._signal.follow(int(arrival))
        if math.isnan(answer.r):
            self._judge_unusable(state.x)
        return x

    def _observe(self, x: NDArray[np.float64]) -> None:
        """Look whether the rig has changed, once the answer is on its way.

        In the contrast where there is one: interference that may outshine the oscillation is not in
        it.
        """
        if self._has_contrast:
            if self._filling():
                return
            x = self._loaded.lifting.projector @ self._loaded.work.z
        if x.size != self._watch.channels:
            self._begin_watch(x.size)
        self._note(self._watch.take(self._answer.step, x))

    @property
    def _has_contrast(self) -> bool:
        return self._source == cost.LIFTED and len(self._loaded.lifting.projector) == 1

    # -- compiled -----------------------------------------------------------------------------

    def lend(self, rehearsal: bool) -> tuple[LifterStage, LifterProgress] | None:
        """Return what :func:`koopman_lifter.stage.answer_next` needs; None: it cannot go on."""
        reader, writer, answer = self.reader, self._publisher, self._answer
        if self._foreign is not None or self._signal is not None:
            return None
        joined = self._input.steady and not (self._state.settling or self._filling())
        source = target = NO_PORT
        if reader is not None and writer is not None and joined:
            state = codec(MeasuredState).new()
            state.header, state.x = answer.header, [0.0] * self._n
            source, target = reader.port(state, STATE), writer.port(answer, COST)
        elif not rehearsal:
            return None
        watched = 1 if self._has_contrast else max(self._n, 1)
        if watched != self._watch.channels:  # what it looks at is written by its number
            self._begin_watch(watched)
        self._note(self._watch.settle())
        stage = LifterStage(
            source, target, self._source, self._loaded.lifting, self._detector, self._loaded.work,
            np.zeros(self._n), np.zeros(watched), self._watch.senses, self._kept,
            self._input.freshness(answer.lockstep),
        )  # fmt: skip
        return stage, LifterProgress(
            answer.step, self._state, self._watch.tally, self._input.clocks
        )

    def take_back(self, before: LifterProgress, after: LifterProgress, now: float) -> None:
        """Go on where the compiled code ended."""
        if (count := after.step - before.step) and self._publisher is not None:
            self._state, self._answer = after.detector, self._publisher.last()
            self._watch.tally = after.tally
            stamp = to_seconds(self._answer.header.stamp)
            self._input.follow_on(count, stamp, now, after.clocks)

    def handle(self, reason: int) -> None:
        super().handle(reason)
        if reason == CHANGED:
            self._note(self._watch.judge())
        elif reason == UNUSABLE and self.reader is not None:
            self._judge_unusable(self.reader.last().x)

    def _begin_watch(self, channels: int = 1) -> None:
        config = self._node.parameters[LifterConfig]
        self._watch = Watch(channels, config.dt, config.begin)
        self._change = None
        self._end_search()

    # -- after a change -----------------------------------------------------------------------

    def _note(self, change: Change | None) -> None:
        """Take a change; what was learned since an earlier one is of a rig that is gone.

        Where interference creeps on, it is learned as it comes.
        """
        if change is not None:
            moved = change.after > 0.0 and not change.interference
            if moved and self._node.parameters[LifterConfig].begin:  # which a restart needs
                self._set("begin", change.after)
            creeps = change.interference and self._change is not None and self._trial is None
            self._change = change
            if not creeps:
                self._end_search()

    def _end_search(self) -> None:
        if self._search is not None:
            self._search.close()
        self._search, self._trial, self._proposed = None, None, ""
        self._kept = candidate.room(self._n or 1)

    def _seek_model(self) -> None:
        """Keep samples, have a model learned from them, and propose it if it is better."""
        config, chosen = self._node.parameters[LifterConfig], self._node.parameters[ModelConfig]
        model, logger, frequency = (
            self._loaded.model,
            self._node.get_logger(),
            self._watch.frequency,
        )
        if frequency is None:
            return
        if self._search is not None:
            if (outcome := self._search.outcome()) is None:
                return
            trial = Trial(chosen.path, frequency, self._kept)
            self._end_search()
            if not outcome.file:
                logger.info(f"no better model yet: {outcome.text}")
                return
            if config.adapt == "always":
                if self._set("model", outcome.file):
                    logger.warning(f"{outcome.text}: in use from now on, on trial")
                    self._trial = trial
                    self._kept = candidate.room(self._n, trial.samples.steps.size)
                return
            self._proposed = outcome.file
            name = self._node.get_fully_qualified_name()
            logger.warning(f"{outcome.text}: ros2 param set {name} model {outcome.file}")
        elif self._proposed or model is None or self._source != cost.LIFTED:
            return
        elif not self._kept.steps.size and chosen.path != shipped_model():
            self._kept = candidate.room(self._n, candidate.size_of(frequency, config.dt))
            logger.info("keeping samples to learn a model of the rig as it is now")
        elif self._kept.full and self._kept.steps.size:
            self._search = Search(model, chosen.path, self._kept, frequency, config.omega_h)

    def _judge(self, trial: Trial) -> None:
        """Keep the new model, or give it back if the oscillation has grown under it."""
        dt, logger = self._node.parameters[LifterConfig].dt, self._node.get_logger()
        name = self._loaded.id
        try:
            factor, has_grown = candidate.growth(trial.samples, self._kept, trial.frequency * dt)
            text = f"the oscillation is {factor:.3g} times what it was before model {name}"
        except InputError as error:
            text, has_grown = f"model {name}: {error}", True
        self._end_search()
        if has_grown:
            logger.warning(f"{text}: back to {trial.before}")
            self._set("model", str(trial.before))
        else:
            logger.info(f"{text}, which stays in use")

    def _set(self, name: str, value: object) -> bool:
        """Set a parameter, as an operator does: between two samples, recorded and replayed."""
        (result,) = self._node.set_parameters([Parameter(name, value=value)])
        if not result.successful:
            self._node.get_logger().error(f"{name} {value} is not used: {result.reason}")
        return bool(result.successful)

    def _use(self, model: KoopmanModel | None) -> None:
        self._loaded = LoadedModel(model)
        self._n = self._loaded.n or self._seen
        text = "no model: the raw cost needs none"
        if model is not None:
            text = f"model {model.model_id}: {model.observables.p} observables"
        self._node.get_logger().info(text)
        self._compile()

    def _taken(self, x: NDArray[np.float64], arrival: Arrival) -> NDArray[np.float64]:
        """Return a state as the kernel takes it: NaN where it has not the run's number of values.

        That is the model's; for the raw cost, any number with which a run begins.
        """
        n = self._seen = x.shape[0]
        if n == self._n:
            return x
        begins = self._n == 0 or arrival in (Arrival.RESTART, Arrival.JOIN)
        if self._source == cost.LIFTED or n == 0 or not begins:
            return np.full(self._n or 1, math.nan)
        if self._loaded.model is not None and self._loaded.n != n:
            self._use(None)
        self._n = n
        return x

    def _filling(self) -> int:
        """Return the samples until the delay line is full; 0 where the cost needs none."""
        return self._loaded.work.filling if self._source == cost.LIFTED else 0

    def _judge_unusable(self, x: array[float]) -> None:
        believed = self._filling() or self._answer.y_out <= self._detector.y_max
        if self._answer.settling and len(x) == self._n and believed and np.isfinite(x).all():
            return
        if len(x) != self._n:
            needed = f"the model {self._loaded.id} needs" if self._loaded.model else "the first had"
            problem = f"state has {len(x)} values, {needed} {self._n}"
        elif self._source == cost.LIFTED and len(self._loaded.work.ring) > 1:
            problem = "a state in the delay line is not finite or y_out too large"
        else:
            problem = f"state {x.tolist()} is not finite or its y_out too large"
        self._input.reject(f"step {self._answer.step}: {problem}")
        self._node.get_logger().error(self._input.problem, throttle_duration_sec=60.0)

    def _compile(self) -> None:
        """Get the kernel for the types that model and messages bring, before the next sample."""
        x = np.frombuffer(MeasuredState(x=[0.0] * (self._n or 1)).x)
        self._kernel = direct(
            cost.answer, self._source, self._loaded.lifting, self._detector,
            cost.joining(self._detector), int(Arrival.JOIN), 0, x, self._loaded.work,
        )  # fmt: skip
        self._loaded.work.cursor[:] = 0
        self._keep = direct(candidate.keep, candidate.room(self._n or 1), 0, x)
        self._begin_watch()


class LifterNode(ManagedNode[LifterRun]):
    """Answers every state with a cost.

    A state that cannot be used (wrong length, not finite) is answered with r = NaN, on which the
    controller holds; the detector goes on with the next usable state. So are the first states of a
    run that is under way already, flagged ``settling``. A state that was overtaken
    by a newer one, or is stale on arrival, is counted and not answered: the
    filters can't go back in time, and nobody must act on what is long past.
    """

    configs = (LifterConfig, ModelConfig, ListenersConfig)
    stage = answer_next

    def __init__(self, name: str = "koopman_lifter", **options: Any) -> None:
        super().__init__(name, LifterRun, **options)
