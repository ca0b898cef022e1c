"""Rates, latencies and losses of a fleet over a time, from its nodes' reports on /diagnostics."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from operator import sub
from typing import NamedTuple

from koop_core.stream.durations import Durations, read


class Counts(NamedTuple):
    """Counts that the three nodes of a loop report, of all their time or of a part of it."""

    time: float
    """Time on the plant's clock when it reported [s]."""
    steps: int
    late: int
    """Periods without a tick."""
    lost: int
    """Messages that lifter and controller missed."""
    trips: Durations
    """From a state to its theta."""
    behind: Durations
    """By how much ticks were late."""

    def since(self, before: Counts) -> Counts:
        """Return the counts from an earlier report on."""
        return Counts(*map(sub, self, before))

    @property
    def rate(self) -> float:
        """Steps a second; 0 where no new report came."""
        return self.steps / self.time if self.time > 0.0 else 0.0


def counts_of(
    namespace: str, values: Mapping[str, Mapping[str, str]], times: Mapping[str, float]
) -> Counts:
    """Return the last report of a loop, from values and times by the nodes' full names."""
    plant = values[f"{namespace}/vdp_plant"]
    lifter = values.get(f"{namespace}/koopman_lifter", {})
    controller = values.get(f"{namespace}/relay_esc", {})
    return Counts(
        times[f"{namespace}/vdp_plant"],
        int(plant["step"]),
        int(plant["late_ticks"]),
        int(lifter.get("state missed_steps", 0)) + int(controller.get("cost missed_steps", 0)),
        read(plant["round_trips"]),
        read(plant["ticks_behind"]),
    )


@dataclass(frozen=True)
class FleetReport:
    """A fleet between two reports of each of its loops."""

    loops: tuple[Counts, ...]
    cpu: float
    """Processor time of the containers as a share of one core."""

    @property
    def ticks(self) -> int:
        """Ticks that were due in all loops."""
        return sum(loop.steps + loop.late for loop in self.loops)

    @property
    def late(self) -> int:
        """Ticks that were missed."""
        return sum(loop.late for loop in self.loops)

    @property
    def lost(self) -> int:
        """Messages missed, and states without a theta; the last one's may be on its way."""
        unanswered = sum(max(loop.steps - loop.trips.count - 1, 0) for loop in self.loops)
        return unanswered + sum(loop.lost for loop in self.loops)

    @property
    def slowest(self) -> float:
        """Steps a second of the slowest loop; 0 if one is silent."""
        return min(loop.rate for loop in self.loops)

    @property
    def cpu_per_loop(self) -> float:
        """Processor time of a loop as a share of one core."""
        return self.cpu / len(self.loops)

    def trip(self, share: float) -> float:
        """Return a quantile of the time from a state to its theta [s]."""
        return sum((loop.trips for loop in self.loops), Durations()).quantile(share)

    def behind(self, share: float) -> float:
        """Return a quantile of how far ticks were behind [s]."""
        return sum((loop.behind for loop in self.loops), Durations()).quantile(share)


def report(before: Iterable[Counts], after: Iterable[Counts], cpu: float) -> FleetReport:
    """Return what happened between two reports of every loop."""
    return FleetReport(tuple(b.since(a) for a, b in zip(before, after, strict=True)), cpu)
