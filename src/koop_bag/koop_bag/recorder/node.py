"""ROS node of the recorder: every topic of a run into an MCAP bag."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from koop_msgs.msg import GuardState
from rcl_interfaces.msg import ParameterEvent
from rclpy.node import NodeNameNonExistentError
from rclpy.qos import qos_profile_parameter_events

from koop_bag.bag.earlier import EarlierRuns, find_earlier
from koop_bag.bag.losses import LossCounter, early_ends
from koop_bag.bag.metadata import OfferedQos, dump
from koop_bag.bag.topics import COMMON_TOPICS
from koop_bag.bag.writer import BagWriter
from koop_bag.errors import BagWriteError
from koop_bag.mcap.chunk import ChunkBuffer, Row
from koop_bag.recorder import run_folder
from koop_bag.recorder.config import LOOP_TOPICS, RecorderConfig, wanted_topics
from koop_bag.recorder.drain import Drain
from koop_bag.recorder.parameters import ParameterCollector
from koop_bag.recorder.summary import SummaryWriter
from koop_bag.recorder.topics import RecordedTopic, fetch, skip, watch
from koop_core.ended import GUARD_IN_ORDER, IN_ORDER, Told
from koop_core.errors import KoopError
from koop_core.journal import Journal, journal_of_process
from koop_node.node.managed import ERROR, OK, WARN, Entities, ManagedNode, Run
from koop_node.node.received import read_message
from koop_node.process.housekeeping import release_compiler

POLL_PERIOD = 0.05  # [s] between fetches of waiting messages; receive times do not depend on it
LOOK_PERIOD = 0.25  # [s] between looks for new topics, publishers and nodes
EARLY_PERIOD, EARLY = 0.05, 5.0  # [s] at first, for a run may be over in less; and how long
GUARD_STATE = "koop_msgs/msg/GuardState"
ALARMS_FULL = (
    "bag/alarms is full, the recording around later trips is dropped: move files away from there"
)
QUIET = 0.2  # [s] without a message after which a stopped run has published everything
PATIENCE = 1.0  # [s] and no longer than this


def _spell(lost: Mapping[str, int]) -> str:
    return ", ".join(f"{count} on {name}" for name, count in lost.items() if count)


class RecorderRun(Run):
    """A recording, from its empty bag to its end."""

    def __init__(self, node: RecorderNode, entities: Entities) -> None:
        config = node.parameters[RecorderConfig]
        self._node = node
        self._config = config
        self._watched: dict[str, Any] = {}  # subscriptions, by node
        self._topics: dict[str, RecordedTopic] = {}
        self._problem = self._scarce = ""
        self._told: dict[str, int] = {}  # lost messages that were reported, by topic
        self._recording = self._paused = False
        self._refused: set[str] = set()
        self._models: dict[str, str] = {}
        self._trips: dict[int, float] = {}  # time of a guard's last one by channel [s]
        self._end = Told()
        chosen = wanted_topics(config.topics) or LOOP_TOPICS | COMMON_TOPICS
        self._awaited = {node.resolve_topic_name(name): kind for name, kind in chosen.items()}
        self._take_all = not config.topics.strip()
        self._journal = journal_of_process()
        self._followed: set[int] = set()  # topics of the journal
        self._drain = Drain(self._journal)
        ChunkBuffer("none", 0, 0)  # compiled before a message may come: the first time takes long
        release_compiler()
        self._collector = ParameterCollector(node, node.get_namespace())
        entities.on_close(self._release)
        entities.subscription(
            ParameterEvent,
            "/parameter_events",
            self._on_parameter_event,
            qos_profile_parameter_events,
        )
        entities.timer(POLL_PERIOD, self._poll)
        self._began: float | None = time.monotonic()
        self._looks = entities.timer(EARLY_PERIOD, self._look_around)
        for name, kind in self._awaited.items():
            if kind:  # before there are publishers: they wait for it with their first message
                self._add_topic(name, kind)
        self._folder = run_folder.make_run_folder(config.output)
        self._versions = run_folder.write_versions(self._folder)
        options = config.writer_options()
        earlier = EarlierRuns(find_earlier(self._folder) if options.is_ring else ())
        self._writer: BagWriter | None = BagWriter(self._folder / "bag", options, earlier=earlier)
        self._summary = SummaryWriter(self._folder) if options.is_ring else None
        node.get_logger().info(f"recording to {self._folder}")

    def activate(self, entities: Entities) -> None:
        # What already waits is recorded the first time: publishers begin as soon as the
        # subscriptions exist. After a pause it was published in the pause.
        if self._paused:
            self._poll()
        self._recording = True

    def deactivate(self) -> None:
        self._poll()
        self._recording, self._paused = False, True
        if self._writer is not None:
            self._guarded(self._writer.flush)

    def close(self) -> None:
        self._finish_bag()

    def samples(self) -> int:
        return sum(topic.count for topic in self._topics.values())

    def diagnose(self) -> tuple[int, str, Mapping[str, object]]:
        if self._writer is None:
            return (ERROR, self._problem, {}) if self._problem else (OK, "", {})
        lost = self._lost()
        values = {
            "messages": self.samples(),
            "bytes": self._writer.bytes_written,
            "file": str(self._writer.path),
            **{f"lost {name}": count for name, count in lost.items()},
        }
        losses = _spell({name: count - self._told.get(name, 0) for name, count in lost.items()})
        self._told = lost
        problems = [self._scarce, ALARMS_FULL if self._writer.alarms_full else ""]
        problems.append(f"lost {losses}" if losses else "")
        problems += [t.foreign or t.silence() for t in self._topics.values()]
        problem = "; ".join(filter(None, problems))
        return (WARN, problem, values) if problem else (OK, "recording", values)

    def fetch_the_last(self) -> None:
        """Go on until nothing comes any more: other nodes that were stopped still publish."""
        begin = last = time.monotonic()
        count = self.samples()
        while time.monotonic() - begin < PATIENCE and time.monotonic() - last < QUIET:
            self._poll()
            if self.samples() > count:
                count, last = self.samples(), time.monotonic()
            time.sleep(0.005)

    def _release(self) -> None:
        """Release what is not an entity of the run, as far as it was made."""
        self._end.close()
        self._collector.close()
        recorded = [topic.subscription for topic in self._topics.values()]
        for subscription in [*filter(None, recorded), *self._watched.values()]:
            self._node.destroy_subscription(subscription)
        self._topics, self._watched = {}, {}

    # -- topics -------------------------------------------------------------------------------

    def _look_around(self) -> None:
        """Find what is new in the graph: topics, publishers with another QoS, nodes."""
        if self._began is not None and time.monotonic() - self._began > EARLY:
            self._began = None
            self._looks.restart(LOOK_PERIOD)
        if self._writer is None:
            return
        prefix = self._node.get_namespace().rstrip("/") + "/"
        used = self._list_used(prefix) if self._take_all and prefix != "/" else set()
        for name, types in self._node.get_topic_names_and_types():
            within = self._take_all and name.startswith(prefix)
            in_reach = name in self._awaited or within or name in used
            if name not in self._topics and in_reach and self._node.count_publishers(name):
                self._awaited.setdefault(name, "")
                self._try_topic(name, types[0])
        for topic in self._topics.values():
            topic.match()
            for name in topic.publishers - self._watched.keys():
                self._watched[name] = watch(self._node, name)
        if self._collector.look():
            self._guarded(self._keep_parameters)
        self._guarded(self._look_at_the_disk)

    def _list_used(self, prefix: str) -> set[str]:
        """Return what nodes of the namespace publish or hear: a rig's topics may lie outside."""
        used = set()
        for node, namespace in self._node.get_node_names_and_namespaces():
            if f"{namespace}/".startswith(prefix) and node != self._node.get_name():
                with suppress(NodeNameNonExistentError):  # it has ended
                    published = self._node.get_publisher_names_and_types_by_node(node, namespace)
                    heard = self._node.get_subscriber_names_and_types_by_node(node, namespace)
                    used |= {topic for topic, _ in (*published, *heard)}
        return used

    def _look_at_the_disk(self) -> None:
        """Make room in time on a disk that fills up, whatever fills it."""
        if self._writer is None:
            return
        with suppress(OSError):
            free = shutil.disk_usage(self._folder).free
            self._scarce = ""
            if free < self._writer.options.reserve:
                self._scarce = f"the disk is nearly full: {free / 1e6:.0f} MB are free"
            self._writer.make_room(free)

    def _try_topic(self, name: str, type_name: str) -> None:
        try:
            self._add_topic(name, type_name)
        except KoopError as error:
            if name not in self._refused:
                self._refused.add(name)
                self._node.get_logger().warning(f"{name} is not recorded: {error}")

    def _add_topic(self, name: str, type_name: str) -> None:
        self._topics[name] = RecordedTopic(
            self._node, name, type_name, self._config.queue, self._announce
        )

    def _announce(self, topic: RecordedTopic) -> int:
        assert self._writer is not None
        offered = topic.offered or (OfferedQos(),)
        channel = self._writer.add_topic(topic.name, topic.schema, offered)
        if self._summary is not None:
            self._summary.watch(channel, topic)
            if topic.schema.name == GUARD_STATE:
                self._trips[channel] = 0.0
        return channel

    # -- writing ------------------------------------------------------------------------------

    def _poll(self) -> None:
        if self._writer is None:
            return
        if self._collector.take():
            self._guarded(self._keep_parameters)
        if self._journal is not None:
            self._follow(self._journal)
        if self._writer is not None and self._recording:
            self._guarded(self._write_waiting)
        else:
            skip(self._drain, [*self._topics.values()], self._watched)

    def _follow(self, journal: Journal) -> None:
        """Take what is in the journal from there; its writers wait until they are known."""
        for number, (name, kind, node) in enumerate(journal.topics()):
            if name not in self._topics and (self._take_all or name in self._awaited):
                self._try_topic(name, kind)
            topic = self._topics.get(name)
            if topic is not None and topic.number < 0:
                topic.follow(number, node)
            known = topic is None or node in topic.publishers & self._collector.values.keys()
            if known and number not in self._followed:
                self._followed.add(number)
                journal.follow(number, self._node.get_name())

    def _write_waiting(self) -> None:
        assert self._writer is not None
        batch = fetch(self._drain, [*self._topics.values()], self._watched)
        self._writer.write_batch(batch)
        rows = [] if self._summary is None else list(batch.rows())
        if self._trips and any([self._is_new_trip(row) for row in rows]):
            self._writer.note_alarm()
        now = time.time_ns()
        self._writer.flush_due(now)
        if self._summary is not None:
            self._summary.add(rows, now)

    def _is_new_trip(self, row: Row) -> bool:
        """Return whether a message says that a guard has tripped; it may say so again.

        That theta returns at an orderly end is no trip.
        """
        _, channel, _, data = row
        last_trip = self._trips.get(channel)
        state = None if last_trip is None else read_message(data, GuardState)
        if state is None:
            return False
        self._trips[channel] = state.tripped_at
        orderly = state.reason in (IN_ORDER, GUARD_IN_ORDER)
        return state.status == GuardState.TRIPPED and state.tripped_at != last_trip and not orderly

    def _finish_bag(self) -> None:
        if self._writer is None:
            return
        writer, self._writer = self._writer, None
        lost = self._lost()
        try:
            self._complete(writer)
        except BagWriteError as error:
            self._fail(str(error))
            return
        self._node.get_logger().info(
            f"{self.samples()} messages, {writer.bytes_written} bytes in {writer.folder}; "
            f"lost messages: {_spell(lost) or 'none'}"
        )
        self._report_ends()

    def _complete(self, writer: BagWriter) -> None:
        """Write what is only known at the end, and close."""
        for topic in self._topics.values():
            topic.match()
            if not topic.channel and topic.offered:
                # a topic with publishers that stayed silent is part of the record
                writer.add_topic(topic.name, topic.schema, topic.offered)
        if self._summary is not None and self._end.why() != IN_ORDER:
            writer.note_alarm()  # of a loop that failed: a guard that was killed says no trip
        writer.custom_data.update(self._custom_data())
        writer.close()
        if self._summary is not None:
            self._summary.close()

    def _report_ends(self) -> None:
        """Log what no gap shows: topics whose record begins late or ends early."""
        counters = self._counters()
        for name, counter in counters.items():
            if counter.first:
                self._node.get_logger().warning(f"{name} begins at step {counter.first}, not at 0")
            if counter.jumps:
                self._node.get_logger().warning(
                    f"the steps of {name} jump ahead {counter.jumps} times: another publisher, or "
                    "a clock that was set; this is not counted as lost"
                )
        for name, missing in early_ends({n: c.last for n, c in counters.items()}).items():
            self._node.get_logger().warning(f"{name} ends {missing} steps before the loop does")

    def _keep_parameters(self) -> None:
        """Write what is known of the nodes beside the bag and, to outlive a crash, into it."""
        assert self._writer is not None
        run_folder.write_parameters(self._folder, self._collector.values)
        self._models |= run_folder.keep_model(self._folder, self._collector.values)
        self._writer.keep(self._custom_data())

    def _on_parameter_event(self, event: ParameterEvent) -> None:
        """Keep what a node announces, and a model that it changes to."""
        self._collector.hear(event)
        names = {p.name: p.value.string_value for p in event.changed_parameters}
        within = event.node.startswith(self._node.get_namespace().rstrip("/") + "/")
        if self._writer is None or not within or not names.get("model"):
            return
        writer, folder = self._writer, self._folder

        def keep() -> None:
            self._models |= run_folder.keep_model(folder, {event.node: names})
            writer.keep(self._custom_data())

        self._guarded(keep)

    def _custom_data(self) -> dict[str, str]:
        return {
            "parameters": run_folder.parameter_text(self._collector.values),
            "versions": dump(self._versions),
            "git_revision": self._versions["git_revision"],
            "models": dump(self._models),
            "inactive": dump({n: c.inactive for n, c in self._counters().items() if c.inactive}),
        }

    def _lost(self) -> dict[str, int]:
        return {t.name: t.losses.lost for t in self._topics.values() if t.losses is not None}

    def _counters(self) -> dict[str, LossCounter]:
        """Return the counters of the topics that have come, by topic."""
        return {t.name: t.losses for t in self._topics.values() if t.losses and t.count}

    def _guarded(self, action: Callable[[], None]) -> None:
        """Write; a disk that fails ends the recording, not the loop."""
        try:
            action()
        except BagWriteError as error:
            writer, self._writer = self._writer, None
            if writer is not None and not writer.closed:  # what failed lies beside the bag
                with suppress(BagWriteError):
                    self._complete(writer)
            self._fail(str(error))

    def _fail(self, problem: str) -> None:
        self._problem = problem
        self._node.get_logger().error(problem)
        self._node.finish(1)


class RecorderNode(ManagedNode[RecorderRun]):
    """Records while it is active.

    A failing disk ends the recording and this node, with exit code 1; no other node notices.
    """

    configs = (RecorderConfig,)

    def __init__(self, name: str = "recorder", **options: Any) -> None:
        super().__init__(name, RecorderRun, **options)

    def close(self) -> None:
        if self.run is not None and self.active:
            self.run.fetch_the_last()
        super().close()
