"""What the lifter does with a state that follows on the last one: compiled, from DDS to DDS.

The answer is :func:`koopman_lifter.cost.answer`'s; what is not plain is left to the node.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import njit
from koop_core.port import (
    FAILED,
    MORE,
    OTHER,
    PLAIN,
    Port,
    copy_header,
    floats,
    receive,
    send,
    word,
)
from koop_core.stream.age import Clocks
from koop_core.stream.arrival import Arrival
from koop_core.stream.fresh import Freshness, is_fresh
from koopman_lifter import candidate, change, cost
from koopman_lifter.candidate import Samples
from koopman_lifter.change import Senses, Tally
from koopman_lifter.cost import DetectorParams, DetectorState, Lifting, Workspace

STATE = ("step", "lockstep", "x")
COST = ("step", "r", "y_out", "settling")
UNUSABLE, CHANGED = FAILED + 1, FAILED + 2
"""Reasons to stop after a state: there is no cost of it; the watch has found something."""


class LifterStage(NamedTuple):
    """What stays the same; see :mod:`koopman_lifter.cost` and :mod:`koopman_lifter.change`."""

    input: Port
    output: Port
    """With the values ``STATE`` and ``COST``."""
    source: int
    lifting: Lifting
    detector: DetectorParams
    work: Workspace
    sample: NDArray[np.float64]
    """Shape (channels,): measured state."""
    seen: NDArray[np.float64]
    """Shape (1,) or (channels,): what the watch looks at: the contrast if there is one, else the
    state."""
    senses: Senses
    """Of the watch."""
    kept: Samples
    """What a candidate is learned from."""
    fresh: Freshness
    """Of a state."""


class LifterProgress(NamedTuple):
    """What changes: the step of the last state, its writer's clock, the detector and the watch."""

    step: int
    detector: DetectorState
    tally: Tally
    clocks: Clocks


@njit()
def answer_next(stage: LifterStage, progress: LifterProgress) -> tuple[int, LifterProgress]:
    """Answer the next state; return a reason to stop, or MORE."""
    port, answer, sample, work = stage.input, stage.output, stage.sample, stage.work
    got = receive(port)
    if got != PLAIN:
        return got, progress
    step = progress.step + 1
    fresh, clocks = is_fresh(stage.fresh, port, 1, progress.clocks)
    if not fresh or word(port, 0)[0] != step or not copy_header(port, answer):
        return OTHER, progress
    measured = floats(port, 2, sample.size)
    for i in range(sample.size):
        sample[i] = measured[i]
    r, y_out, settling, detector = cost.answer(
        stage.source, stage.lifting, stage.detector, progress.detector, Arrival.NEXT, step, sample,
        work,
    )  # fmt: skip
    word(answer, 0)[0] = step
    floats(answer, 1, 1)[0] = r
    floats(answer, 2, 1)[0] = y_out
    answer.data[answer.at[3]] = settling
    if not send(answer):
        return FAILED, progress
    tally, seen = progress.tally, stage.seen
    if stage.source == cost.LIFTED and stage.lifting.projector.shape[0] == 1:
        seen[0] = 0.0
        for i in range(work.z.size):
            seen[0] += stage.lifting.projector[0, i] * work.z[i]
    else:
        for i in range(sample.size):
            seen[i] = sample[i]
    if not y_out > stage.detector.y_max:
        candidate.keep(stage.kept, step, sample)
        tally = change.hear(stage.senses, tally, step, seen)
    reason = MORE
    if max(tally.above.s, tally.below.s) > stage.senses.threshold:
        reason = CHANGED
    if math.isnan(r):
        reason = UNUSABLE
    return reason, LifterProgress(step, detector, tally, clocks)
