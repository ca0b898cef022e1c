"""The messages of a bag in time order, each when it is due. Pure: no ROS, no clock of its own."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Collection, Iterable, Iterator
from typing import Any

from koop_bag.bag.reader import BagReader, RawMessage

Source = Callable[[int], Iterator[RawMessage]]
"""The messages from a log time [ns] on."""

REORDER_WINDOW = 200_000_000
"""How far [ns] behind a later one a message may lie in the file: recorders write in batches."""

SHORTEST_PASS = 1_000_000
"""A bag of one message, looped, takes this long [ns], not no time at all."""


def in_time_order(
    messages: Iterable[RawMessage], window: int = REORDER_WINDOW
) -> Iterator[RawMessage]:
    """Messages sorted by log time, equal times in the order of the file, with bounded memory.

    A message that lies further than `window` [ns] from its place comes late, not never.
    """
    waiting: list[tuple[int, int, RawMessage]] = []
    newest = 0
    for number, message in enumerate(messages):
        newest = max(newest, message.log_time)
        heapq.heappush(waiting, (message.log_time, number, message))
        while waiting and waiting[0][0] <= newest - window:
            yield heapq.heappop(waiting)[2]
    while waiting:
        yield heapq.heappop(waiting)[2]


class Timeline:
    """Bag time [ns] against a steady clock [s].

    Parameters
    ----------
    rate : float
        Bag seconds in a second; infinite plays everything at once.
    """

    def __init__(self, rate: float = 1.0) -> None:
        self._rate = rate
        self._bag = 0
        self._now = 0.0
        self._running = False

    @property
    def paced(self) -> bool:
        """Whether bag time passes, neither standing still nor all at once."""
        return self._running and not math.isinf(self._rate)

    def bag_time(self, now: float) -> int:
        """Bag time at a time of the steady clock; at an infinite rate, where it was set last."""
        if not self.paced:
            return self._bag
        return self._bag + round((now - self._now) * self._rate * 1e9)

    def due(self, bag_time: int) -> float:
        """When a bag time is reached [s]."""
        if not self._running:
            return math.inf
        return self._now + (bag_time - self._bag) * 1e-9 / self._rate

    def set(self, bag_time: int, now: float) -> None:
        """Be at a bag time."""
        self._bag, self._now = bag_time, now

    def set_rate(self, rate: float, now: float) -> None:
        """Go on from here at another rate."""
        self.set(self.bag_time(now), now)
        self._rate = rate

    def run(self, now: float) -> None:
        """Let bag time pass."""
        if not self._running:
            self._now, self._running = now, True

    def stop(self, now: float) -> None:
        """Let bag time stand still."""
        self.set(self.bag_time(now), now)
        self._running = False


class Playback:
    """Decides when each message of a bag is due; iterated, it yields all of them at once.

    The player publishes what :meth:`take` returns. A replay or a page's connection, which have a
    pace of their own, iterate over :meth:`of_bag`.

    Parameters
    ----------
    source : callable
        The messages from a log time on, in the order in which they are published.
    begin, end : int
        Log times [ns] between which a pass runs; messages after `end` are left out.
    rate : float
        Bag seconds in a second; infinite: without a pace.
    loop : bool
        Begin again after the end.

    Notes
    -----
    All times `now` are seconds of one steady clock. A message that is overdue is taken at once, in
    its order, and none is left out.
    """

    def __init__(
        self,
        source: Source,
        begin: int,
        end: int,
        *,
        rate: float = 1.0,
        loop: bool = False,
    ) -> None:
        self._source, self.begin = source, begin
        self.end = max(end, begin + SHORTEST_PASS)
        self._timeline = Timeline(rate)
        self.loop = loop
        self.passes = 0
        self.lateness = 0.0
        """How long after its time the last message went out [s]."""
        self._started = self._paused = False
        self._position = begin
        self._timeline.set(begin, 0.0)
        self._open(begin)

    @classmethod
    def of_bag(
        cls,
        bag: BagReader,
        topics: Collection[str] | None = None,
        *,
        window: int = REORDER_WINDOW,
        **options: Any,
    ) -> Playback:
        """Return the playback of a bag, by default without a pace.

        Parameters
        ----------
        bag : BagReader
            The bag.
        topics : collection of str, optional
            Only these.
        window : int
            See :func:`in_time_order`; 0 keeps the order of the file.
        options
            Of the constructor, besides source, begin and end.
        """

        def messages_from(log_time: int) -> Iterator[RawMessage]:
            return in_time_order(bag.messages(topics, start=log_time), window)

        return cls(messages_from, bag.start_time, bag.end_time, **{"rate": math.inf, **options})

    def __iter__(self) -> Iterator[RawMessage]:
        self.start(0.0)
        while (message := self.take(0.0)) is not None:
            yield message

    # -- control ------------------------------------------------------------------------------

    def start(self, now: float) -> None:
        """Begin, or go on where :meth:`stop` was called; a pause stays one."""
        self._started = True
        if not self._paused:
            self._timeline.run(now)

    def stop(self, now: float) -> None:
        """Stand still until :meth:`start`."""
        self._started = False
        self._timeline.stop(now)

    @property
    def paused(self) -> bool:
        """Whether it stands still until :meth:`resume`."""
        return self._paused

    def pause(self, now: float) -> None:
        """Stand still."""
        self._paused = True
        self._timeline.stop(now)

    def resume(self, now: float) -> None:
        """Go on after a pause."""
        if self._paused:
            self._paused = False
            self._timeline.set(self.position(now), now)
            if self._started:
                self._timeline.run(now)

    def seek(self, bag_time: int, now: float) -> None:
        """Go on at a log time."""
        self._timeline.set(bag_time, now)
        self._position = bag_time
        self._open(bag_time)

    def set_rate(self, rate: float, now: float) -> None:
        """Change the rate without a jump."""
        self._timeline.set_rate(rate, now)

    # -- playing ------------------------------------------------------------------------------

    def take(self, now: float) -> RawMessage | None:
        """The next message if it is due."""
        message = self._next
        if message is None or self.wait(now) > 0.0:
            return None
        due = self._timeline.due(message.log_time)
        self.lateness = now - due if self._timeline.paced else 0.0
        self._position = max(self._position, message.log_time)
        self._advance(now)
        return message

    def wait(self, now: float) -> float:
        """Time until a message is due [s]: infinite if that takes a call of another method."""
        if self._next is None or self._paused:
            return math.inf
        return max(0.0, self._timeline.due(self._next.log_time) - now)

    @property
    def finished(self) -> bool:
        """Whether everything was taken."""
        return self._next is None

    def position(self, now: float) -> int:
        """Log time that the playback has reached [ns]."""
        return max(self._position, min(self._timeline.bag_time(now), self.end))

    def _open(self, bag_time: int) -> None:
        self._messages = self._source(bag_time)
        self._next = self._following()

    def _following(self) -> RawMessage | None:
        message = next(self._messages, None)
        return None if message is None or message.log_time > self.end else message

    def _advance(self, now: float) -> None:
        self._next = self._following()
        if self._next is not None or not self.loop:
            return
        # The next pass begins when this one is over, which may be after its last message.
        over = self._timeline.due(self.end)
        self.passes += 1
        self._position = self.begin
        self._timeline.set(self.begin, over if math.isfinite(over) else now)
        self._open(self.begin)
