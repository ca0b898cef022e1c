"""Files in memory, for what must work though the disk is full."""

from __future__ import annotations

import ctypes
import os
from typing import BinaryIO

_MFD_CLOEXEC = 1  # linux/memfd.h


def open_memory_file(name: str) -> BinaryIO:
    """Open a file that is in memory until nobody holds it; OSError where none can be had.

    By the C library: a Python that was built for an older one lacks ``os.memfd_create``.
    """
    descriptor = ctypes.CDLL(None, use_errno=True).memfd_create(name.encode(), _MFD_CLOEXEC)
    if descriptor < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return open(descriptor, "w+b")
