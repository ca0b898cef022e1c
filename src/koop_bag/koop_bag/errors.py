"""What can go wrong with a bag. Each message says what happened and what to do about it."""

_LONGEST = 800  # characters


class BagError(Exception):
    """A bag that is absent, foreign or damaged, or a request that it cannot answer.

    Its text is one line that can be printed whatever names the bag holds: other characters are
    written as in Python, and what is too long is cut.
    """

    def __str__(self) -> str:
        words = super().__str__()
        if not words.isprintable():
            words = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in words)
        return words if len(words) <= _LONGEST else f"{words[: _LONGEST - 3]}..."


class BagWriteError(BagError):
    """A bag could not be written on; what was written before stays readable."""


class DiskFullError(BagWriteError):
    """No space, quota or file size left."""
