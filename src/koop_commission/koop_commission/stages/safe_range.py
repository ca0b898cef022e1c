"""Moves theta step by step, to where a constraint allows, before an excitation begins."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from koop_commission.stages.session import Session, spell_time
from koop_core.config.constraint import Constraint
from koop_core.errors import LiveError
from koop_tune.excitation.safe_range import SAFE_RANGE, SafeRange, SafeRangeSearch, forecast
from koop_tune.rig.rig_file import RigFile


def find_safe_range(rig: RigFile, constraint: Constraint, session: Session) -> SafeRange:
    """Return the thetas that keep the constraint; theta is at theta_safe then.

    Raises
    ------
    koop_core.errors.LiveError
        If the constraint is not kept at theta_safe, or its signal is not heard.
    """
    window = math.ceil(constraint.window / rig.dt)
    margins = Margins(session, window)
    search = SafeRangeSearch(rig)
    holds, seconds = forecast(rig, constraint.window)
    tqdm.write(
        f"looking from theta_safe = {rig.theta_safe:g} on how far the constraint lets theta go: "
        f"{rig.constraint}; {holds} holds in {spell_time(seconds, rig.pace)} if it lets it go "
        "everywhere, more near the bound; Ctrl-C ends it, theta returns to theta_safe",
    )
    kept = rig.theta_safe
    while (theta := search.next()) is not None:
        if (theta - rig.theta_safe) * (kept - rig.theta_safe) < 0.0:
            session.go([rig.theta_safe])  # the other side
        session.go([theta])
        margin = margins.hold()
        search.take(theta, margin)
        tqdm.write(f"theta {theta:<9.4g} margin {margin:.2g}")
        if margin >= 0.0:
            kept = theta
            continue
        if theta == rig.theta_safe:
            raise LiveError(f"the constraint {rig.constraint} is not kept at theta_safe")
        session.go([kept])
        margins.recover()
    safe = search.result()
    session.go([rig.theta_safe])
    if safe.low >= safe.high:
        raise LiveError(f"the constraint {rig.constraint} is kept at theta_safe alone")
    tqdm.write(describe(safe, rig))
    return safe


def describe(safe: SafeRange, rig: RigFile) -> str:
    """Return in words how far theta may go."""
    ends = [
        f"{name} {value:.4g}" + (" (the rig file's)" if not bound else "")
        for name, value, bound in (
            ("theta_min", safe.low, safe.bound_low), ("theta_max", safe.high, safe.bound_high)
        )
    ]  # fmt: skip
    return f"the constraint is kept from {' to '.join(ends)}"


class Margins:
    """Margins of a constraint, as the lifter tells them; ``window`` states have its statistic."""

    def __init__(self, session: Session, window: int) -> None:
        self._listener = session.listen_to_margins()
        self._session, self._window = session, window

    def hold(self) -> float:
        """Return the margin that is left once it does not change any more; its least.

        It is below 0 as soon as the bound is broken.
        """
        s, begin = SAFE_RANGE, self._listener.count
        for count in range(s.windows, s.longest + 1):
            self._wait(begin + count * self._window)
            margins = self._margins(begin)
            if margins[-1] < 0.0:
                return float(margins[-1])
            last, before = margins[-self._window :], margins[-2 * self._window : -self._window]
            if abs(last.mean() - before.mean()) < max(s.settled, float(last.std())):
                break
        if not np.isfinite(last).all():
            raise LiveError("the signal of the constraint is not heard, or not a finite number")
        return float(last.min())

    def recover(self) -> None:
        """Wait until a margin is left again."""
        begin, listener = self._listener.count, self._listener
        self._session.wait_until(lambda: listener.count > begin and self._newest >= 0.0)

    def _wait(self, count: int) -> None:
        """Wait for costs, or until the bound is broken."""
        session, listener = self._session, self._listener
        begin = listener.count
        session.wait_until(
            lambda: listener.count >= count or (listener.count > begin and self._newest < 0.0)
        )

    @property
    def _newest(self) -> float:
        return float(self._margins(self._listener.count - 1)[0])

    def _margins(self, begin: int) -> NDArray[np.float64]:
        return self._listener.samples(begin).x[:, 0]
