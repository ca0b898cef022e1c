"""Asks, waits, asks again, gives up. Pure: no ROS, and time is an argument."""

from __future__ import annotations

from enum import Enum


class Due(Enum):
    """The next action for an open question."""

    WAIT = "wait"
    AGAIN = "ask again"
    GIVE_UP = "give up"


class Resend:
    """One question at a time.

    An answer may take ``timeout`` [s] before it is asked for again, 0: for ever; after so many
    resends it is given up.
    """

    def __init__(self, timeout: float, resends: int) -> None:
        self.timeout = timeout
        self.resends = resends
        self.resent = 0  # how often the open question was asked again
        self._since: float | None = None

    @property
    def open(self) -> bool:
        """Whether an answer is expected."""
        return self._since is not None

    @property
    def overdue(self) -> bool:
        """Whether the open question was asked again."""
        return self.resent > 0

    def ask(self, now: float) -> None:
        """Expect an answer to a question that went out."""
        self._since, self.resent = now, 0

    def close(self) -> bool:
        """Expect no answer any more; return whether the question was overdue."""
        overdue, self.resent, self._since = self.overdue, 0, None
        return overdue

    def check(self, now: float) -> Due:
        """Return what is due; AGAIN counts as asked, and the waiting starts over."""
        if self._since is None or self.timeout == 0.0 or now - self._since < self.timeout:
            return Due.WAIT
        if self.resent == self.resends:
            return Due.GIVE_UP
        self.resent += 1
        self._since = now
        return Due.AGAIN
