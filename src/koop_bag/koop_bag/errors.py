"""What can go wrong with a bag. Each message says what happened and what to do about it."""

from koop_node.config import one_line


class BagError(Exception):
    """A bag that is absent, foreign or damaged, or a request that it cannot answer.

    Its text is one line that can be printed whatever names the bag holds.
    """

    def __str__(self) -> str:
        return one_line(super().__str__())


class BagWriteError(BagError):
    """A bag could not be written on; what was written before stays readable."""


class DiskFullError(BagWriteError):
    """No space, quota or file size left."""
