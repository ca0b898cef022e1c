"""ROS node of the guard: the controller's theta in, the rig's command out."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

from koop_msgs.msg import ControlInput, Cost, GuardState, MeasuredState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from koop_core.config.knobs import format_knobs
from koop_core.ended import GUARD_IN_ORDER, IN_ORDER, Told
from koop_core.stream.arrival import Arrival
from koop_core.stream.monitor import StreamMonitor
from koop_core.stream.report import GHOST
from koop_guard.config import SAFETY, GuardConfig
from koop_guard.guard import Cause, Guard, Status, Trip
from koop_guard.node.alarm import Alarm
from koop_guard.node.twin import Twin
from koop_guard.node.wire import Command, Return, describe_theta, return_to_safe
from koop_guard.note import NOT_NOTED, Keeper, Note, find_theta, leave, read
from koop_guard.presence import Presence
from koop_node.client.question import Question
from koop_node.node import schedule
from koop_node.node.adapter import StateAdapter
from koop_node.node.entities import Input
from koop_node.node.graph import (
    Listeners,
    full_name,
    identify_publishers,
    identify_subscribers,
    publishers_of,
    subscribers_of,
)
from koop_node.node.managed import ERROR, OK, WARN, Entities, ManagedNode, Run, message_type
from koop_node.node.qos import BEST_EFFORT, KEPT, RELIABLE
from koop_node.node.stamps import to_seconds

LOOK = 1.0  # [s] between two looks at the graph


class GuardRun(Run):
    """A guard, from the first look at its rig on."""

    def __init__(self, node: GuardNode, entities: Entities) -> None:
        config = self._config = node.parameters[GuardConfig]
        self._node, self._topics = node, [source.topic for source in config.commands]
        self._adapter = StateAdapter(config.source, config.dt)
        self._counts_steps = False
        self._guard = Guard(config, config.each("theta_start"))
        self._states = StreamMonitor(config.source.topic, 0.0, config.dt, may_end=True)
        self._silence = SAFETY.silence(config.period)
        self._answers = StreamMonitor(config.asked, self._silence, config.dt, newest_counts=True)
        self.inputs = (self._answers, self._states)
        self._header: Any = None
        self._last, self._sent = (0, 0.0), 0.0  # step of the newest state, and when it came
        self._moved = 0  # step at which theta moved last
        self._lockstep = False
        self._begun = math.inf  # when the rig could first be commanded [s]
        self._target: tuple[float, ...] = ()
        self._target_heard = math.inf
        self._to_target = False  # whether theta moves there, not to what the controller asks for
        self._answer: Any = None
        self._answered = -1  # newest step that the guard answered itself
        self._said: object = None
        self._refused = ""
        self._alarm = Alarm(config, node.get_logger().error)
        self._command: Command | None = None
        self._twin: Twin | None = None
        self._order: tuple[Any, ...] = ()  # what the twin may have to command
        self._presence: Presence | None = None
        self._listeners = [0] * len(config.commands)  # of each topic of the command
        self._measured: Input | None = None
        self._controller: Any = None  # its ~/reset
        self._rearming: tuple[Question, bool] | None = None  # of the controller; by hand?
        self._return: Return | None = None
        self._latched: Trip | None = None  # what the guard before this one has left
        self._dated: tuple[Trip | None, float] = None, 0.0
        self._keeper: Keeper | None = None
        self._told: Told | None = None  # why the loop ends
        self._state = entities.publisher(GuardState, "~/state", KEPT)
        entities.service(Trigger, "~/trip", self._on_trip)
        entities.service(Trigger, "~/rearm", self._on_rearm)

    def activate(self, entities: Entities) -> None:
        config, source = self._config, self._config.source

        def command(*kinds: str) -> None:
            if len(kinds) < len(self._topics):
                topic = self._topics[len(kinds)]
                entities.when_typed(subscribers_of, topic, lambda kind: command(*kinds, kind))
                return
            self._command = Command(entities.publisher, config.commands, kinds)
            entities.when_typed(publishers_of, source.topic, lambda name: listen(name, kinds))

        def listen(name: str, kinds: Sequence[str]) -> None:
            state = message_type(name, source.fields)
            self._counts_steps = state is MeasuredState
            publishers, subscribers = self._identify()
            self._presence = Presence(publishers, subscribers, config.period)
            theta, remark = find_theta(config.note, config, publishers)
            if remark:
                self._node.get_logger().warning(remark)
            self._guard = Guard(config, theta)
            left = read(config.note)
            if left is not None and (failure := leave(config.note, left)):
                where = format_knobs(left.theta)
                text = f"{failure}: theta was left at {where} or, if that was not noted, elsewhere"
                self._node.get_logger().error(text)
            if left is not None and left.command == config.command:
                self._guard.rearmed = left.rearmed
                if left.trip is not None:
                    ago = time.time() - left.trip.when
                    self._latched = replace(left.trip, when=time.monotonic() - ago)
                    self._dated = self._latched, left.trip.when
            self._keeper = Keeper(config.note, self._note)
            topics = [self._node.resolve_topic_name(topic) for topic in self._topics]
            measured = self._node.resolve_topic_name(source.topic)
            self._order = (asdict(config), topics, kinds, measured)
            assert self._twin is not None
            self._twin.prepare(*self._order)
            entities.waiting_for = "waiting for its twin"
            waiting = entities.timer(0.05, lambda: begin(state, waiting))

        def begin(state: Any, waiting: Any) -> None:
            assert self._command is not None
            assert self._twin is not None
            if not self._twin.shared.ready and self._twin.process.poll() is None:
                self._renew_twin()
                return
            waiting.cancel()
            entities.waiting_for = ""
            if config.bounded is not None:
                entities.reader(Cost, "cost", self._on_cost, BEST_EFFORT)
            qos = RELIABLE if self._counts_steps else BEST_EFFORT
            self._measured = entities.dated_subscription(state, source.topic, self._on_state, qos)
            rig = {publisher: Listeners(next="any") for publisher in self._command.publishers}
            entities.when_heard(rig, lambda: follow())

        def follow() -> None:
            self._begun = time.monotonic()
            entities.dated_subscription(ControlInput, config.asked, self._on_answer, RELIABLE)
            entities.subscription(
                Float64MultiArray, "~/target", lambda m: self._on_target(m, entities), KEPT
            )
            entities.timer(SAFETY.tick, self._on_tick)
            entities.timer(LOOK, self._look)
            self._look()

        self._told = Told()
        self._twin = Twin()  # its start takes the longest
        command()

    def may_end(self, number: int) -> bool:
        """Return whether theta is where the end leaves it; SIGTERM says that the loop failed."""
        if not self._commands or self._holds_at_end(number):
            return True
        now = time.monotonic()
        self._guard.note(Cause.ENDED, self._told.why() if self._told else IN_ORDER, now)
        if self._return is None:
            assert self._command is not None
            self._return = Return(self._guard, self._command)
        return self._return.is_over(now)

    def deactivate(self) -> None:
        """Return theta to theta_safe if it is not there; this takes its time."""
        guard, now = self._guard, time.monotonic()
        held = self._holds_at_end(_asked_to_end())
        if self._commands and not held and not guard.at_safe:
            guard.note(Cause.ENDED, GUARD_IN_ORDER, now)
            self._announce()
            assert self._command is not None
            return_to_safe(guard, self._config, self._command, self._advance, self._last)
        if self._keeper is not None:
            self._keeper.close()
            if self._keeper.failure:
                self._node.get_logger().error(f"{NOT_NOTED}: {self._keeper.failure}")
        self._announce()
        if self._commands:
            self._node.get_logger().info(describe_theta(guard, self._config))
        if self._twin is not None:
            self._twin.release(guard.theta)
        if self._controller is not None:
            self._node.destroy_client(self._controller)
        if self._told is not None:
            self._told.close()
        self._told = self._twin = self._command = self._controller = self._answer = self._keeper = (
            None
        )
        self._presence = self._measured = None
        self._latched = self._rearming = None  # the note knows, the next time
        self._to_target, self._target, self._target_heard = False, (), math.inf

    def _holds_at_end(self, number: int) -> bool:
        following = self._guard.status is Status.FOLLOWING
        return following and self._config.on_end == "hold" and number != signal.SIGTERM

    @property
    def _commands(self) -> bool:
        """Whether theta was commanded."""
        return self._command is not None and self._guard.status is not Status.WAITING

    def _note(self) -> Note | None:
        """Return what is noted now; called in a thread of its own."""
        guard, config = self._guard, self._config
        if not self._commands:
            return None
        trip = self._latched  # a command, which sets targets, does not change it
        if math.isinf(self._target_heard):
            trip = guard.trip if guard.status is Status.TRIPPED else None
        if trip is not None:
            ended = trip.cause is Cause.ENDED
            trip = None if ended else replace(trip, when=self._date(trip))
        publishers = self._presence.publishers if self._presence is not None else ()
        return Note(guard.theta, config.command, publishers, trip, guard.rearmed)

    def _date(self, trip: Trip) -> float:
        """Return the system time of a trip [s], as the clock was then: it may be set later."""
        if self._dated[0] is not trip:
            self._dated = trip, time.time() - time.monotonic() + trip.when
        return self._dated[1]

    def samples(self) -> int:
        return self._states.count

    def diagnose(self) -> tuple[int, str, Mapping[str, object]]:
        guard, trip = self._guard, self._guard.trip
        twin = self._twin
        values: dict[str, object] = {
            "status": guard.status.name.lower(),
            "theta": format_knobs(guard.theta, ""),
            "rearms_left": max(self._config.rearms - guard.rearmed, 0),
            "twin": twin.process.pid if twin is not None else 0,
        }
        failure = self._keeper.failure if self._keeper is not None else ""
        unknown = failure and f"{NOT_NOTED}: {failure}"
        if trip is not None:
            values |= {"cause": trip.cause.value, "reason": trip.reason, "tripped_x": list(trip.x)}
        if guard.status is Status.TRIPPED and trip is not None:
            refusal = guard.refusal(time.monotonic())
            then = time.localtime(self._date(trip))
            when = time.strftime("%Y-%m-%d %H:%M:%S", then)  # it may have been in an earlier run
            why = f"tripped: {trip.reason}, at {when}" + f"; {unknown}" * bool(unknown)
            why += self._describe_rearms()
            values["rearm_refused"] = refusal
            if self._ends_in_order(trip):
                return OK, self._describe_return(trip), values
            if refusal:
                return ERROR, f"no rearm now: {refusal}; {why}", values
            return ERROR, f"{why}; rearm it: koop status --rearm, or the page", values
        if guard.status is Status.WAITING:
            return WARN, "nothing is commanded: the controller has not answered yet", values
        if twin is not None and not (twin.shared.ready and twin.process.poll() is None):
            return WARN, "the guard's twin is not ready", values
        if unknown:
            return WARN, unknown, values
        return OK, "moves theta to ~/target" if self._to_target else "following", values

    def _ends_in_order(self, trip: Trip) -> bool:
        """Return whether it is an end that is no failure, of which SIGTERM tells."""
        return trip.cause is Cause.ENDED and _asked_to_end() != signal.SIGTERM

    def _describe_return(self, trip: Trip) -> str:
        how = "is at" if self._guard.at_safe else "returns to"
        return f"theta {how} {self._safe}: {trip.reason}"

    def _describe_rearms(self) -> str:
        """Say when the guard rearms itself, and how often it does."""
        guard = self._guard
        if math.isinf(guard.pause):
            return ""
        when = f"{guard.pause:g} s after its cause is gone"
        if not math.isinf(guard.rearms_at):
            ahead = guard.rearms_at - time.monotonic()
            when = time.strftime("at %H:%M:%S", time.localtime(time.time() + ahead))
        left = self._config.rearms - guard.rearmed
        return f"; it rearms itself {when}, {left} of {self._config.rearms} left"

    def _on_state(self, message: Any, written: float) -> None:
        now = time.monotonic()
        self._tell_rig(now)
        step, x = self._adapter.convert(message)
        if self._counts_steps:
            step = message.step
        header = getattr(message, "header", None)
        stamp = getattr(header, "stamp", None)
        if self._states.hear(step, to_seconds(stamp), now, written) is Arrival.TOO_OLD:
            return  # no run has such a step, and neither the twin nor the rig could be told of it
        self._header, self._last = header, (max(step, 0), now)
        if self._counts_steps:
            self._lockstep = message.lockstep
        guard = self._guard
        guard.hear_state(x, now)
        if self._to_target:  # not before the rig receives
            guard.go(self._target if now - self._begun > SAFETY.matched else guard.theta)
        if self._to_target or guard.status is Status.TRIPPED:
            self._say(now)

    def _on_cost(self, cost: Any, written: float) -> None:
        self._guard.hear_margin(cost.margin, time.monotonic())

    def _answer_state(self, state: Any, written: float) -> None:
        """Answer a state of the loop with what is commanded, where no controller does."""
        guard, self._answered = self._guard, min(self._answered, state.step)  # a run may restart
        if self._to_target or guard.status is Status.TRIPPED:
            answer = ControlInput(theta=guard.theta, step=state.step, holding=guard.arrived)
            answer.header = state.header
            self._answer.publish(answer)
            self._answered = state.step

    def _on_target(self, target: Any, entities: Entities) -> None:
        """Move theta to a target from now on; without numbers: follow the controller again."""
        if self._answer is None:
            self._answer = entities.publisher(ControlInput, "~/theta", RELIABLE)
            entities.dated_subscription(MeasuredState, "state", self._answer_state, RELIABLE)
        self._target_heard = now = time.monotonic()
        if target.data:
            self._to_target = True
        elif self._target:
            self._guard.follow(now + SAFETY.hang)
        self._target = tuple(target.data)

    def _on_answer(self, answer: Any, written: float) -> None:
        now = time.monotonic()
        if self._command is None:
            return
        arrival = self._answers.hear(answer.step, to_seconds(answer.header.stamp), now, written)
        if arrival is Arrival.LATE or (self._to_target and self._target):
            return
        old = arrival is Arrival.TOO_OLD or self._is_past(answer)
        waits = self._guard.status is Status.WAITING and math.isinf(self._target_heard)
        if waits and self._latched is not None:
            self._node.get_logger().warning("the loop had tripped: it stays so until ~/rearm")
            self._guard.latch(self._latched)
        self._guard.hear_answer(answer.theta, answer.saturated, now, old)
        if self._guard.status is Status.FOLLOWING and not old and not self._is_held(now):
            self._to_target = False
            self._command.pass_on(answer, self._advance(now))
            if self._answer is not None and answer.step > self._answered:
                self._answer.publish(answer)  # a controller that was behind would answer twice

    def _is_past(self, answer: Any) -> bool:
        """Return whether an answer is to a state of long ago, by the rig's own stamps."""
        newest = to_seconds(getattr(self._header, "stamp", None))
        stamp = to_seconds(answer.header.stamp)
        return bool(newest and stamp) and newest - stamp > self._silence * self._config.pace

    def _on_tick(self) -> None:
        now, guard = time.monotonic(), self._guard
        self._alarm.check()
        self._is_held(now)  # who has joined is looked at
        guard.hear_time(now)
        if now - self._target_heard > SAFETY.hang:
            text = f"the command that set a target gave no sign of life for {SAFETY.hang:g} s"
            guard.note(Cause.SILENT, text, now)
        if guard.status is Status.TRIPPED and now - self._sent > max(
            SAFETY.tick, 2.0 * self._config.period
        ):
            self._say(now)
        elif self._twin is not None:
            self._twin.shared.write(guard.theta, now, self._commands, self._last)
        if self._rearming is not None:
            self._finish_rearm(*self._rearming)
        elif guard.may_rearm_itself(now):
            self._reset_controller(by_hand=False)
        if self._news() != self._said:
            self._announce()

    @property
    def _safe(self) -> str:
        return f"theta_safe = {format_knobs(self._config.each('theta_safe'))}"

    def _look(self) -> None:
        """Look at the graph for other publishers, and at the twin."""
        now, guard, node = time.monotonic(), self._guard, self._node
        self._renew_twin()
        self._look_at_rig(now)
        config = self._config
        controllers = publishers_of(node, config.asked)
        if guard.status is not Status.WAITING:
            for cause, topic, infos in (
                (Cause.DOUBLED, config.asked, controllers),
                (Cause.RIG_DOUBLED, config.source.topic, publishers_of(node, config.source.topic)),
            ):
                if len(infos) > 1:
                    names = " and ".join(map(full_name, infos))
                    guard.note(cause, f"{topic} is published by {names} ({GHOST})", now)
        mine = node.get_fully_qualified_name()
        for topic in self._topics:
            commanding = [full_name(info) for info in publishers_of(node, topic)]
            if mine in commanding:
                commanding.remove(mine)
                if commanding:
                    others = f"{topic} is also commanded by {', '.join(commanding)}"
                    text = f"{others}, which moves theta, too: stop that ({GHOST})"
                    guard.note(Cause.OTHER, text, now)
        if not (controllers or self._to_target) and guard.status is Status.FOLLOWING:
            guard.note(Cause.INACTIVE, "the controller is inactive or has ended", now)
        if len(controllers) == 1 and full_name(controllers[0]).startswith("/"):  # its name is known
            self._find_reset(f"{full_name(controllers[0])}/reset")
        self._announce()

    def _identify(self) -> tuple[set[str], list[set[str]]]:
        """Return the ids of who publishes what is measured, and of who takes each command."""
        takers = [identify_subscribers(self._node, topic) for topic in self._topics]
        return identify_publishers(self._node, self._config.source.topic), takers

    def _tell_rig(self, now: float) -> None:
        """Tell by a message of the measured channels whether the rig lives or was restarted."""
        if self._presence is None or self._measured is None:
            return
        number = self._measured.number
        if not self._presence.continues(number):
            self._look_at_rig(now)
        self._presence.hear(number, now)
        if self._presence.is_doubtful:
            self._look_at_rig(now)

    def _is_held(self, now: float) -> bool:
        """Return whether nothing is commanded, as it is not known whether the rig was restarted.

        In lockstep it refuses what does not answer its step.
        """
        if self._presence is None or self._command is None:
            return False
        before = self._listeners
        self._listeners = [p.get_subscription_count() for p in self._command.publishers]
        if any(a < b for a, b in zip(before, self._listeners, strict=True)):
            self._presence.doubt(now)
        if self._presence.is_doubtful:
            self._look_at_rig(now)
        return self._presence.is_held(now) and not self._lockstep

    def _look_at_rig(self, now: float) -> None:
        """Go on from theta_start where the rig was restarted."""
        if self._presence is None or not (again := self._presence.see(*self._identify(), now)):
            return
        theta, start = list(self._guard.theta), self._config.each("theta_start")
        topics = [i for i, source in enumerate(self._config.commands) for _ in source.fields]
        knobs = [knob for knob, topic in enumerate(topics) if topic in again]
        left, stands = ([values[i] for i in knobs] for values in (theta, start))
        for i in knobs:
            theta[i] = start[i]
        self._guard.stand(theta)
        named = [self._config.knob_names[i] for i in knobs]
        which = f" ({', '.join(named)})" if len(knobs) < len(theta) else ""
        self._node.get_logger().warning(
            f"the rig was restarted since theta was at {format_knobs(left)}{which}: "
            f"assuming theta_start = {format_knobs(stands)}"
        )

    def _renew_twin(self) -> None:
        """Start another twin where it has ended, or hangs at its start."""
        twin = self._twin
        if twin is None:
            return
        ended = twin.process.poll() is not None
        if ended or twin.hangs(time.monotonic()):
            how = "has ended" if ended else "does not get ready"
            self._node.get_logger().error(f"the guard's twin {how}: another one is started")
            twin.process.kill()
            try:
                self._twin = Twin()
            except OSError as error:  # theta must not be left to nobody: it is tried again
                self._node.get_logger().error(f"it cannot be started: {error}")
                return
            self._twin.prepare(*self._order)

    def _find_reset(self, service: str) -> None:
        if self._controller is not None:
            if self._controller.srv_name == service:
                return
            self._node.destroy_client(self._controller)
            self._rearming = None
        self._controller = self._node.create_client(Trigger, service)

    def _advance(self, now: float) -> tuple[float, ...]:
        """Move theta on; the twin knows it before the rig does."""
        steps, self._moved = self._last[0] - self._moved, self._last[0]
        if self._lockstep and steps:  # its time is counted in steps
            theta = self._guard.move(steps * self._config.period)
        else:
            theta = self._guard.advance(now)
        if self._twin is not None:
            self._twin.shared.write(theta, now, True, self._last)
        self._sent = now
        return theta

    def _say(self, now: float) -> None:
        if self._command is not None and not self._is_held(now):
            self._command.say(self._advance(now), self._last[0], self._header)

    def _news(self) -> object:
        """Return what is announced as soon as it changes."""
        guard = self._guard
        arrived = guard.arrived and (self._to_target or guard.status is Status.TRIPPED)
        return guard.status, guard.theta if arrived else None, guard.trip

    def _announce(self) -> None:
        """Publish the state if it is another one."""
        now, guard, trip = time.monotonic(), self._guard, self._guard.trip
        clock = self._node.get_clock().now()
        message = GuardState(status=int(guard.status), theta=guard.theta)
        message.header.stamp = clock.to_msg()
        if trip is not None:
            message.cause, message.reason = trip.cause.value, trip.reason
            message.tripped_at = 1e-9 * clock.nanoseconds - (now - trip.when)
            message.tripped_theta, message.tripped_x = trip.theta, list(trip.x)
        message.rearm_refused = guard.refusal(now)
        message.rearms_left = max(self._config.rearms - guard.rearmed, 0)
        said = self._news()
        if said != self._said or message.rearm_refused != self._refused:
            if trip is not None and guard.status is Status.TRIPPED and said != self._said:
                if self._ends_in_order(trip):
                    self._node.get_logger().info(self._describe_return(trip))
                else:
                    self._node.get_logger().error(self._describe_return(trip))
                    if trip is not self._latched:  # whose alarm was before the restart
                        self._alarm.start(trip, self._node.get_fully_qualified_name())
            self._said, self._refused = said, message.rearm_refused
            self._state.publish(message)
            if self._keeper is not None:
                self._keeper.hurry()

    def _on_trip(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self._command is not None
        response.message = "nothing is commanded"
        if response.success:
            self._guard.note(Cause.ASKED, "~/trip was called", time.monotonic())
            self._say(time.monotonic())
            self._announce()
            response.message = f"theta returns to {self._safe}"
        return response

    def _on_rearm(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        refusal = self._guard.refusal(time.monotonic()) or self._reset_controller(by_hand=True)
        response.success = not refusal
        response.message = f"refused: {refusal}" if refusal else "the controller begins again"
        return response

    def _reset_controller(self, by_hand: bool) -> str:
        """Let the controller begin again, then follow it; return why that cannot be."""
        if self._controller is None or not self._controller.service_is_ready():
            return "there is no controller that can be reset"
        self._rearming = Question(self._controller, Trigger.Request()), by_hand
        return ""

    def _finish_rearm(self, reset: Question, by_hand: bool) -> None:
        """Follow the controller once it has answered that it begins again.

        Not if the cause of the trip is back by then, or the controller has gone.
        """
        refusal, answered = self._guard.refusal(time.monotonic()), reset.answer() is not None
        if answered and not refusal:
            self._guard.rearm(time.monotonic(), by_hand)
        if answered or refusal or not self._controller.service_is_ready():
            self._rearming = None


def _asked_to_end() -> int:
    """Return the signal that asked this process to end; 0: none."""
    current = schedule.current()
    return current.asked if current is not None else 0


class GuardNode(ManagedNode[GuardRun]):
    """Stands between the controller and the rig, and alone commands the rig.

    Theta keeps its limits and its rate. It returns to theta_safe, and stays there until
    ``~/rearm``, when a measured channel is beyond its limit, not finite, stuck or silent, when the
    controller is silent, too old, inactive or doubled, and after ``~/trip``. While ``~/target``
    holds numbers, theta moves there and the controller is not heard. An orderly end does
    what ``on_end`` says; if the guard is killed, its twin returns theta to theta_safe.
    """

    configs = (GuardConfig,)

    def __init__(self, name: str = "koop_guard", **options: Any) -> None:
        super().__init__(name, GuardRun, **options)
