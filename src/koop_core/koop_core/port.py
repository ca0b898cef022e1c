"""Subscriptions and publishers as compiled code sees them: rcl's functions, fixed places. Pure.

Checked against rcl 9.2 (Jazzy) and its public interface::

    rcl_ret_t rcl_take_serialized_message(
        const rcl_subscription_t *, rcl_serialized_message_t *, rmw_message_info_t *,
        rmw_subscription_allocation_t *);
    rcl_ret_t rcl_publish_serialized_message(
        const rcl_publisher_t *, const rcl_serialized_message_t *,
        rmw_publisher_allocation_t *);

A message of other length words than the last one, or one that does not fit, is Python's to read.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.borrowed import overlay
from koop_core.foreign import call
from koop_core.journal import NOWHERE, Place, append
from koop_core.kernels import njit

IDLE, MORE, OTHER, FAILED = range(4)
"""Nothing waits; code goes on. Why it stops: a message is Python's, rcl failed; a stage's own."""
PLAIN = MORE


class Port(NamedTuple):
    """A subscription or a publisher, the memory of its message, and where its values lie."""

    function: int
    handle: int
    """Addresses of rcl's function and of the entity."""
    message: NDArray[np.int64]
    """Shape (8,): an rcl_serialized_message_t: address, bytes and capacity of its buffer,
    allocator."""
    info: NDArray[np.int64]
    """Shape (INFO,): an rmw_message_info_t."""
    data: NDArray[np.uint8]
    """Shape (CAPACITY,): the buffer."""
    guards: NDArray[np.int64]
    """Shape (G, 2): offset and value of each length word."""
    size: int
    """Bytes of a message."""
    at: NDArray[np.int64]
    """Shape (V,): offsets of the values that the code reads or writes, in its order."""
    journal: Place
    """Of a publisher: where its messages are written, too."""


NO_PORT = Port(
    0, 0, np.zeros(8, np.int64), np.zeros(1, np.int64), np.zeros(1, np.uint8),
    np.zeros((1, 2), np.int64), 0, np.zeros(1, np.int64), NOWHERE,
)  # fmt: skip
"""What compiled code is compiled with before there is a subscription."""


@njit()
def take(function: int, handle: int, message: NDArray[np.int64], info: NDArray[np.int64]) -> bool:
    """Take a message into its memory, which rcl may move for it; return whether one came."""
    return bool(call(function, handle, message.ctypes.data, info.ctypes.data, 0) == 0)


@njit()
def receive(port: Port) -> int:
    """Take a message: return IDLE, PLAIN or OTHER; what is OTHER is in the memory, too."""
    message, data = port.message, port.data
    address = message[0]
    if not take(port.function, port.handle, message, port.info):
        return IDLE
    if message[0] != address or message[1] < port.size or data[0] != 0 or data[1] != 1:
        return OTHER
    for i in range(port.guards.shape[0]):
        if overlay(data, port.guards[i, 0], 1, np.uint32)[0] != port.guards[i, 1]:
            return OTHER
    return PLAIN


@njit()
def send(port: Port) -> bool:
    """Publish what is in the memory; return whether rcl did."""
    if call(port.function, port.handle, port.message.ctypes.data, 0, 0) != 0:
        return False
    append(port.journal, port.message[0], port.message[1])
    return True


@njit()
def floats(port: Port, i: int, count: int) -> NDArray[np.float64]:
    """Return the i-th of the port's values, so many float64 in a row, as an array over it."""
    view: NDArray[np.float64] = overlay(port.data, port.at[i], count, np.float64)
    return view


@njit()
def word(port: Port, i: int) -> NDArray[np.int64]:
    """Return the i-th of the port's values, an integer of 64 bits, as an array of one over it."""
    view: NDArray[np.int64] = overlay(port.data, port.at[i], 1, np.int64)
    return view


@njit()
def half_word(port: Port, i: int) -> NDArray[np.int32]:
    """Return the i-th of the port's values, an integer of 32 bits, as an array of one over it."""
    view: NDArray[np.int32] = overlay(port.data, port.at[i], 1, np.int32)
    return view


@njit()
def copy_header(source: Port, target: Port) -> bool:
    """Copy the stamp; return False, and do nothing, where the frames are not the same."""
    at, length = source.guards[0, 0] + 4, source.guards[0, 1]
    for i in range(at, at + length):
        if source.data[i] != target.data[i]:
            return False
    for i in range(4, 12):
        target.data[i] = source.data[i]
    return True
