"""What the controller does with a cost that follows on the last one: compiled, from DDS to DDS.

The answer is :func:`relay_esc.barrier.answer`'s; what is not plain is left to the node.
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
from relay_esc import barrier, relay
from relay_esc.barrier import BarrierParams, BarrierState
from relay_esc.relay import RelayParams, RelayState

COST = ("step", "dt", "r", "source", "settling", "margin", "model_id", "lockstep")
THETA = (
    "step", "theta", "epsilon", "cost_rise_filtered", "saturated", "holding", "swing", "gradient",
    "noise", "confidence",
)  # fmt: skip


class ControllerStage(NamedTuple):
    """What stays the same; see :mod:`relay_esc.barrier`."""

    input: Port
    output: Port
    """With the values ``COST`` and ``THETA``."""
    dt: float
    """Of the costs [s]."""
    source: int
    """Of the costs; so is ``model_id``, a text's bytes."""
    model_id: NDArray[np.uint8]
    params: RelayParams
    bound: BarrierParams
    hold_asked: bool
    """Whether the user holds theta."""
    level_most: int
    """Costs of a window of :class:`relay_esc.level.CostLevel`, less one."""
    level_floor: float
    """Least cost that counts there."""
    fresh: Freshness
    """Of a cost."""


class ControllerProgress(NamedTuple):
    """What changes.

    That is the step of the last cost, relay, barrier, the level's sum and count, and the clock of
    the costs' writer.
    """

    step: int
    relay: RelayState
    barrier: BarrierState
    level_sum: float
    level_count: int
    clocks: Clocks


@njit()
def answer_next(
    stage: ControllerStage, progress: ControllerProgress
) -> tuple[int, ControllerProgress]:
    """Answer the next cost; return a reason to stop, or MORE."""
    port, answer = stage.input, stage.output
    got = receive(port)
    if got != PLAIN:
        return got, progress
    step = progress.step + 1
    r = floats(port, 2, 1)[0]
    plain = word(port, 0)[0] == step and floats(port, 1, 1)[0] == stage.dt and math.isfinite(r)
    plain = plain and port.data[port.at[3]] == stage.source and port.data[port.at[4]] == 0
    fresh, clocks = is_fresh(stage.fresh, port, 7, progress.clocks)
    plain = plain and fresh
    plain = plain and progress.level_count < stage.level_most
    for i in range(stage.model_id.size):
        plain = plain and port.data[port.at[6] + i] == stage.model_id[i]
    if not plain or not copy_header(port, answer):
        return OTHER, progress
    state, barrier_state, holding, saturated = barrier.answer(
        stage.params, stage.bound, progress.relay, progress.barrier, Arrival.NEXT, False, False, r,
        stage.hold_asked, floats(port, 5, 1)[0],
    )  # fmt: skip
    word(answer, 0)[0] = step
    floats(answer, 1, 1)[0] = state.output
    answer.data[answer.at[2]] = state.epsilon
    floats(answer, 3, 1)[0] = state.cost_rise_filtered
    answer.data[answer.at[4]] = saturated
    answer.data[answer.at[5]] = holding
    floats(answer, 6, 1)[0] = state.swing.factor
    gradient, noise, confidence = relay.insight(stage.params, state)
    floats(answer, 7, 1)[0] = gradient
    floats(answer, 8, 1)[0] = noise
    floats(answer, 9, 1)[0] = confidence
    if not send(answer):
        return FAILED, progress
    level_sum, level_count = progress.level_sum, progress.level_count
    if not holding and r >= stage.level_floor:
        level_sum, level_count = level_sum + r, level_count + 1
    return MORE, ControllerProgress(step, state, barrier_state, level_sum, level_count, clocks)
