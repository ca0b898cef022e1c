"""What the recorded answers of the controller say: who gave them, and how old what they answer was.

Pure: arrays in, figures out. Times are nanoseconds on the clock of whoever published.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Columns = Mapping[str, NDArray[Any]]


def answered_twice(cost: Columns, theta: Columns) -> int:
    """Return how many answers too many there are: those of a second controller.

    A cost that was repeated may be answered again.

    Parameters
    ----------
    cost, theta : mapping
        ``step`` of every message.

    >>> answered_twice({"step": np.array([1, 2, 2])}, {"step": np.array([1, 1, 2, 2])})
    1
    """
    asked, times_asked = np.unique(cost["step"], return_counts=True)
    answered, times_answered = np.unique(theta["step"], return_counts=True)
    _, here, there = np.intersect1d(answered, asked, return_indices=True)
    extra = times_answered[here].astype(int) - times_asked[there].astype(int)
    return int(np.maximum(extra, 0).sum())


@dataclass(frozen=True)
class Ages:
    """How old states were when answers to them had an effect [s]; 0 where there was none.

    Attributes
    ----------
    acted : float
        Oldest state whose answer moved theta on the plant.
    sent : float
        Oldest state whose answer moved the theta that the controller sent.
    unexplained : int
        Moves of theta on the plant to a value that the controller had not sent.
    """

    acted: float
    sent: float
    unexplained: int


def ages(state: Columns, theta: Columns, ground_truth: Columns) -> Ages:
    """Return how old the states were that theta answered.

    A theta that acts is known by its value, so the plant must not limit its rate. Where several
    answers have that very value, the newest counts: it would have acted just so. A move in a gap of
    the recording counts as early as it can have been.

    Parameters
    ----------
    state : mapping
        ``step`` and ``publish_time``.
    theta : mapping
        ``step``, ``publish_time`` and ``theta``.
    ground_truth : mapping
        ``step``, ``publish_time`` and ``theta_applied``.
    """
    measured = dict(
        zip(state["step"].tolist(), state["publish_time"].astype(np.int64).tolist(), strict=True)
    )
    given: dict[float, list[int]] = defaultdict(list)
    for step, value in sorted(zip(theta["step"].tolist(), theta["theta"].tolist(), strict=True)):
        given[value].append(step)
    acted, unexplained = 0, 0
    applied, at = ground_truth["theta_applied"], ground_truth["publish_time"].astype(np.int64)
    dated = np.diff(ground_truth["step"].astype(np.int64), prepend=-1) == 1
    for i in (np.flatnonzero(np.diff(applied)) + 1).tolist():
        answers = given.get(float(applied[i]), [])
        older = bisect_left(answers, int(ground_truth["step"][i]))
        if older == 0:
            unexplained += int(dated[i])
        elif (measured_at := measured.get(answers[older - 1])) is not None:
            acted = max(acted, int(at[i] if dated[i] else at[i - 1]) - measured_at)
    sent = 0
    order = np.argsort(theta["publish_time"], kind="stable")
    for i in order[np.flatnonzero(np.diff(theta["theta"][order])) + 1].tolist():
        if (measured_at := measured.get(int(theta["step"][i]))) is not None:
            sent = max(sent, int(theta["publish_time"][i]) - measured_at)
    return Ages(acted * 1e-9, sent * 1e-9, unexplained)


def active_times(transitions: Columns) -> list[tuple[int, int]]:
    """Return begin and end of every time in which a managed node was active.

    Parameters
    ----------
    transitions : mapping
        ``publish_time``, ``start_state.label`` and ``goal_state.label`` of its transition events.

    >>> event = {"publish_time": np.array([5]), "start_state.label": np.array(["active"]),
    ...          "goal_state.label": np.array(["deactivating"])}
    >>> active_times(event)
    [(0, 5)]
    """
    events = sorted(
        zip(
            transitions["publish_time"].tolist(),
            transitions["start_state.label"].tolist(),
            transitions["goal_state.label"].tolist(),
            strict=True,
        )
    )
    times, begin = [], None
    if not events or events[0][1] == "active":  # since before the recording
        begin = 0
    for at, start, goal in events:
        if goal == "active":
            begin = at
        elif start == "active" and begin is not None:
            times.append((begin, at))
            begin = None
    if begin is not None:
        times.append((begin, np.iinfo(np.int64).max))
    return times


def authors(
    theta: Columns, active: Mapping[str, list[tuple[int, int]]]
) -> tuple[dict[str, int], int]:
    """Return how many thetas came while each controller alone was active, and how many did not.

    Parameters
    ----------
    theta : mapping
        ``publish_time``.
    active : mapping
        :func:`active_times` of every controller.
    """
    at = theta["publish_time"].astype(np.int64)
    who = {
        name: np.logical_or.reduce([(begin <= at) & (at <= end) for begin, end in times])
        if times
        else np.zeros(at.size, bool)
        for name, times in active.items()
    }
    count = np.sum(list(who.values()), axis=0)
    alone = {name: int((mask & (count == 1)).sum()) for name, mask in who.items()}
    return alone, int((count != 1).sum())
