"""Tells a rig that was restarted from others that join its topics. Pure: no ROS.

A rig that was restarted has another publisher of its measured channels in place of the one that
ended, and another subscriber of its command, which stands at theta_start. Of one that was killed
the graph of the domain shows the endpoints for some 20 s more: that these have ended shows as none
of their messages comes. While it is not known who has joined, nothing should be commanded.

Endpoints are known by their ids, which begin with that of their program.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence

from koop_guard.config import SAFETY

PROGRAM = 24  # hexadecimal digits of an id that are the program's
LIVES, SHORTEST = 3.0, 0.25  # periods, and [s], without a message, after which it may have ended
START = 0.1  # [s] no program is restarted within; the graph shows an endpoint within that, too


class Presence:
    """Who publishes the measured channels of a rig, and who takes each topic of its command."""

    def __init__(
        self, publishers: Collection[str], takers: Sequence[Collection[str]], period: float
    ) -> None:
        self._rig = set(publishers)
        self._publishers = self._known = frozenset(publishers)
        self._subscribers = [frozenset(of) for of in takers]
        self._known_subscribers = list(self._subscribers)
        programs = _programs(publishers)
        self._takers = [{i for i in of if i[:PROGRAM] in programs} or set(of) for of in takers]
        self._ends = max(LIVES * period, SHORTEST)
        self._number, self._heard = 0, -math.inf
        self._other_heard = False
        self._doubted, self._replaced = math.inf, -math.inf
        self._begun = [-math.inf] * len(takers)

    @property
    def publishers(self) -> tuple[str, ...]:
        """Ids of the rig's publishers."""
        return tuple(sorted(self._rig))

    @property
    def is_doubtful(self) -> bool:
        """Whether somebody has joined of whom it is not known who it is."""
        return self._doubted < math.inf

    def is_held(self, now: float) -> bool:
        """Return whether nothing should be commanded."""
        return self.is_doubtful and now - self._heard > START

    def doubt(self, now: float) -> None:
        """Take note that somebody has joined."""
        self._doubted = min(self._doubted, now)

    def continues(self, number: int) -> bool:
        """Return whether a message follows on the rig's last one, by its publisher's count."""
        return number == 0 or number > self._number

    def hear(self, number: int, now: float) -> None:
        """Take a message of the measured channels; its number is 0 where DDS gives none."""
        follows = self.continues(number) if number else now - self._heard <= self._ends
        if follows or self._publishers <= self._known:
            self._number, self._heard = number, now
        else:
            self._other_heard = True

    def see(
        self, publishers: Iterable[str], subscribers: Sequence[Iterable[str]], now: float
    ) -> list[int]:
        """Take who is there; return the numbers of the command's topics that begin again.

        Who takes these now was restarted: it stands at theta_start.
        """
        self._publishers = frozenset(publishers)
        self._subscribers = [frozenset(of) for of in subscribers]
        others = self._publishers - self._known
        joined = [a - b for a, b in zip(self._subscribers, self._known_subscribers, strict=True)]
        if not others and not any(joined):
            if now - self._doubted > START:
                self._doubted = math.inf
            return []
        self.doubt(now)
        lives = self._heard > self._doubted
        silent = now - self._heard > self._ends
        waited = now - self._doubted > SAFETY.matched
        has_ended = silent and (self._other_heard or waited)
        if others and (not self._publishers & self._rig or has_ended):
            self._rig, self._known = set(others), self._known | others
            self._number, self._heard, self._replaced, self._doubted = 0, now, now, now
            lives = False
        again = [i for i, ids in enumerate(joined) if ids and self._begins(i, ids, silent, now)]
        for i in again:
            self._takers[i], self._begun[i] = set(joined[i]), now
            self._known_subscribers[i] |= joined[i]
        if lives or waited:
            self._rig |= self._publishers if lives else set()
            self._known |= self._publishers
            known = zip(self._known_subscribers, self._subscribers, strict=True)
            self._known_subscribers = [a | b for a, b in known]
        self._other_heard = self._other_heard and not self._publishers <= self._known
        if self._publishers <= self._known and all(
            a <= b for a, b in zip(self._subscribers, self._known_subscribers, strict=True)
        ):
            self._doubted = math.inf
        return again

    def _begins(self, i: int, joined: Collection[str], silent: bool, now: float) -> bool:
        """Return whether who has joined a topic of the command takes it for the rig."""
        if self._replaced > -math.inf:
            if now - self._replaced <= SAFETY.matched < now - self._begun[i]:
                return True
            if _programs(joined) & _programs(self._rig) - _programs(self._takers[i]):
                return True  # it subscribes long after it published
        return silent and not self._takers[i] & self._subscribers[i]


def _programs(ids: Iterable[str]) -> set[str]:
    return {i[:PROGRAM] for i in ids}
