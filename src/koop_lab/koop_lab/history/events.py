"""A sentence for each thing that happened to a loop."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

from koop_core.config.knobs import format_knobs
from koop_core.stream.report import LEVELS
from koop_guard.guard import Cause, Status
from koop_guard.note import THETA_LEFT
from koop_lab.history.read import GuardMessage, HealthMessage, History, RunSpan

BRIEF = 5.0  # [s] below which a warning is not told, as the log of a node does not
SAME = 2.0  # [s] within which two guards tell of the same trip: a clock is set by less
NEAR = 600.0  # [s] between troubles of a node that are told together
MOST = 500  # sentences


class Event(NamedTuple):
    """An event: begin and end [s since the epoch], and a sentence."""

    begin: float
    end: float
    text: str


class Trouble(NamedTuple):
    """A node that was not well: from when, to when [s since the epoch], its worst level."""

    begin: float
    end: float
    node: str
    level: int
    text: str


def list_events(history: History) -> list[Event]:
    """Return what happened, in order."""
    told = (_runs, trips, faults, _models, _health)
    events = [event for tell in told for event in tell(history)]
    return sorted(events)


def format_span(seconds: float) -> str:
    """Return a duration in its natural unit.

    >>> format_span(90.0), format_span(5.0)
    ('1.5 min', '5 s')
    """
    for name, size in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 1.5 * size or (name != "d" and seconds >= size):
            return f"{seconds / size:.3g} {name}"
    return f"{seconds:.2g} s"


def trips(history: History) -> list[Event]:
    """Return the guard's trips, each until the controller commanded again.

    One that is latched over restarts of the loop is one trip. That theta returned when the loop
    ended is none.
    """
    events = []
    trip: GuardMessage | None = None
    last = 0.0  # when the guard last said that it is tripped
    for message in history.guard:
        tripped = message.status == Status.TRIPPED and message.cause != Cause.ENDED
        if message.status == Status.FOLLOWING and trip is not None:
            events.append(_trip(trip, message.time, "; rearmed after "))
            trip = None
        elif tripped:
            end = None if trip is None else _end_between(history, last, message.time)
            # it is latched, also over a restart of the loop
            if trip is not None and end and abs(message.tripped - trip.tripped) > SAME:
                events.append(_trip(trip, end, "; the recording ended after "))
                trip = None
            trip, last = trip or message, message.time
    if trip is not None:
        end = _end_between(history, last, math.inf) or last
        ended = end < max(run.end for run in history.runs)
        how = "the recording ended after" if ended else "not rearmed until the end, for"
        events.append(_trip(trip, end, f"; {how} "))
    return events


def faults(history: History) -> list[Event]:
    """Return the ends of the loop that were not in order, and where theta went."""
    return [fault for run in history.runs if (fault := _fault(run, history)) is not None]


def troubles(history: History) -> list[Trouble]:
    """Return when nodes were not well; the guard's trips are told by the guard."""
    troubles: list[Trouble] = []
    nodes: dict[str, list[HealthMessage]] = {}
    for message in history.health:
        if not message.node.endswith("/koop_guard"):
            nodes.setdefault(message.node, []).append(message)
    for node, messages in nodes.items():
        last = HealthMessage(max(run.end for run in history.runs), node, 0, "")
        for message, after in pairwise([*messages, last]):
            end = _end_between(history, message.time, after.time) or after.time
            if troubles and troubles[-1][1:4] == (message.time, node, message.level):  # it lasts
                troubles[-1] = troubles[-1]._replace(end=end)
            elif message.level:
                troubles.append(Trouble(message.time, end, node, message.level, message.text))
    return sorted(troubles)


def _trip(trip: GuardMessage, end: float, how: str) -> Event:
    at = format_knobs([value for value in trip.tripped_theta if math.isfinite(value)], ".4g")
    text = (
        f"The guard tripped at theta = {at}: {trip.reason or trip.cause}; "
        f"theta returned to theta_safe{how}{format_span(end - trip.time)}."
    )
    return Event(trip.time, end, text)


def _fault(run: RunSpan, history: History) -> Event | None:
    ended = run.ended
    if ended is None or (ended.time and not ended.failure):
        return None
    if ended.time:
        left = ended.theta[max(ended.theta.find(THETA_LEFT), 0) :]
        text = f"The loop ended by a fault: {ended.failure}" + f"; {left}" * bool(left)
        return Event(ended.time, ended.time, f"{text}.")
    if not run.closed:  # it may still go on
        return None
    said = [message for message in history.guard if run.begin - 1.0 <= message.time <= run.end]
    begin = next((m.time for m in said if m.cause == Cause.ENDED), run.end)
    text = "The loop ended by a fault: koop up was killed, for it noted no end"
    if said and said[-1].status == Status.TRIPPED:
        theta = format_knobs([value for value in said[-1].theta if math.isfinite(value)])
        text += (
            f"; theta was last recorded at {theta}, on its way to theta_safe or there: the guard "
            "outlasts the recording, and its log says where it left theta"
        )
    return Event(begin, begin, f"{text}.")


def _end_between(history: History, begin: float, end: float) -> float | None:
    """Return when the run that holds the first time ended, if that is before the second."""
    ends = [run.end for run in history.runs if run.begin - 1.0 <= begin <= run.end < end]
    return max(ends, default=None)


def _runs(history: History) -> Iterator[Event]:
    before = None
    for run in history.runs:
        pause = ""
        if before is not None and run.begin > before.end:
            pause = f", after {format_span(run.begin - before.end)} without one"
        where = f"the recording in {run.folder}{pause}."
        yield Event(run.begin, run.begin, f"Here begins {where}")
        lost = () if run.ended is None else run.ended.lost
        for time, how in lost:
            yield Event(time, time, f"{how}; the loop went on without it.")
        if not run.closed and not lost:
            text = "This recording was not closed: it still goes on, or its recorder was killed."
            yield Event(run.end, run.end, text)
        before = run


def _models(history: History) -> Iterator[Event]:
    for (_, old), (time, new) in pairwise(history.models):
        yield Event(time, time, f"The cost came from model {new} in place of {old}.")


def _health(history: History) -> Iterator[Event]:
    """Yield troubles that lasted or were errors; near ones of a node together."""
    together: list[Trouble] = []
    by_node = sorted(troubles(history), key=lambda trouble: (trouble.node, trouble.begin))
    lasting = [t for t in by_node if t.level > 1 or t.end - t.begin >= BRIEF]
    for trouble in lasting:
        if together and (
            trouble.node != together[-1].node or trouble.begin - together[-1].end > NEAR
        ):
            yield _tell(together)
            together = []
        together.append(trouble)
    if together:
        yield _tell(together)


def _tell(together: list[Trouble]) -> Event:
    worst = max(together, key=lambda trouble: (trouble.level, trouble.end - trouble.begin))
    lasted = format_span(sum(trouble.end - trouble.begin for trouble in together))
    times = "" if len(together) == 1 else f" {len(together)} times, together"
    level = LEVELS[min(worst.level, len(LEVELS) - 1)]
    name = worst.node.rpartition("/")[2]
    text = f"{name} said {level}{times} for {lasted}: {worst.text}."
    return Event(together[0].begin, together[-1].end, text)
