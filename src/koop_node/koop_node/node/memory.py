"""The memory of messages that compiled code takes and publishes; see :mod:`koop_core.port`."""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

from koop_core.foreign import address_of
from koop_core.journal import NOWHERE, Place
from koop_core.port import Port
from koop_node.node.wire import Places

CAPACITY = 4096  # [B] at first: rcl takes more for a message that does not fit
INFO = 16  # words for an rmw_message_info_t, of which it has 8; its first is the source's time


class Memory:
    """The memory of one message, which rcl may take for a larger one."""

    def __init__(self) -> None:
        self.message = np.zeros(8, np.int64)
        self.info = np.zeros(INFO, np.int64)
        rcutils, allocator = _rcutils()
        code = rcutils.rcutils_uint8_array_init(
            self.message.ctypes.data, CAPACITY, ctypes.addressof(allocator)
        )
        if code:
            raise MemoryError(f"no memory for a message: rcutils returns {code}")
        weakref.finalize(self, _free, self.message)
        self._watch()

    def _watch(self) -> None:
        address, _, capacity = self.message[:3].tolist()
        self.data = np.ctypeslib.as_array((ctypes.c_uint8 * capacity).from_address(address))

    def read(self) -> bytes:
        """Return the message that was taken last."""
        address, _, capacity = self.message[:3].tolist()
        if (address, capacity) != (self.data.ctypes.data, self.data.size):  # it did not fit
            self._watch()
        return self.data[: self.message[1]].tobytes()

    def write(self, data: bytes) -> None:
        """Put a message there; ValueError if it does not fit."""
        if len(data) > len(self.data):
            raise ValueError(f"a message of {len(data)} bytes does not fit {len(self.data)}")
        self.data[: len(data)] = np.frombuffer(data, np.uint8)
        self.message[1] = len(data)

    def port(
        self,
        entity: Subscription | Publisher,
        places: Places,
        names: Sequence[str],
        journal: Place = NOWHERE,
    ) -> Port:
        """Return what compiled code needs; valid while entity and memory are there."""
        take = isinstance(entity, Subscription)
        return Port(
            functions()[take], entity.handle.pointer, self.message, self.info, self.data,
            places.guards, places.size, np.array([places.at[name] for name in names]),
            journal,
        )  # fmt: skip


def _free(message: NDArray[np.int64]) -> None:
    _rcutils()[0].rcutils_uint8_array_fini(message.ctypes.data)


@cache
def _rcutils() -> tuple[Any, Any]:
    rcutils = ctypes.CDLL("librcutils.so")
    rcutils.rcutils_get_default_allocator.restype = _Allocator
    rcutils.rcutils_uint8_array_init.argtypes = [
        ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p,
    ]  # fmt: skip
    rcutils.rcutils_uint8_array_fini.argtypes = [ctypes.c_void_p]
    return rcutils, rcutils.rcutils_get_default_allocator()


class _Allocator(ctypes.Structure):
    """An rcutils_allocator_t: four functions and their state."""

    _fields_ = (("words", ctypes.c_void_p * 5),)


@cache
def functions() -> tuple[int, int]:
    """Return the addresses of the functions that publish and that take."""
    rcl = ctypes.CDLL("librcl.so")
    return (
        address_of(rcl.rcl_publish_serialized_message), address_of(rcl.rcl_take_serialized_message)
    )  # fmt: skip
