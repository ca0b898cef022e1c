"""Errors of bags. Each message says what happened and how to mend it."""

from koop_core.errors import KoopError


class BagError(KoopError):
    """A bag that is absent, foreign or damaged, or a request that it cannot answer."""


class BagWriteError(BagError):
    """A bag could not be written on; what was written before stays readable."""


class DiskFullError(BagWriteError):
    """No space, quota or file size left."""
