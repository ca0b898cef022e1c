"""Errors that a user can mend. Each message is one line that says what is wrong and what to do.

Any other exception that reaches the command line is a fault of this software: it ends in a
traceback.
"""

_LONGEST = 800  # characters of an error


def one_line(text: str) -> str:
    r"""Return a text as one line that can be printed, whatever it quotes; too long ones are cut.

    >>> one_line("unknown\n  fault '\x1b[31m'")
    "unknown fault '\\x1b[31m'"
    """
    if not text.isprintable():
        words = " ".join(text.split())
        text = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in words)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


class KoopError(Exception):
    """Base class of the errors that a user can mend."""

    def __str__(self) -> str:
        return one_line(super().__str__())


class InputError(KoopError, ValueError):
    """Data, an option or a file that cannot be used."""


class LiveError(KoopError, RuntimeError):
    """Nodes that run could not do what was asked; the message says which and why."""
