"""Rates, latencies and losses of a fleet over a time, from its nodes' reports on /diagnostics."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import reduce

from koop_core.stream.durations import Durations, read


@dataclass(frozen=True)
class Snapshot:
    """Last reports of the three nodes of a loop.

    Attributes
    ----------
    time : float
        Of the plant's report, by its own clock [s].
    step, late, lost : int
        Steps done, periods without a tick, messages that lifter and controller missed.
    round_trips, behind : Durations
        From a state to its theta, and by how much ticks were late.
    """

    time: float
    step: int
    late: int
    lost: int
    round_trips: Durations
    behind: Durations


def snapshot(
    namespace: str, values: Mapping[str, Mapping[str, str]], times: Mapping[str, float]
) -> Snapshot:
    """Return the last report of a loop, from values and times by the nodes' full names."""
    plant = values[f"{namespace}/vdp_plant"]
    lifter = values.get(f"{namespace}/koopman_lifter", {})
    controller = values.get(f"{namespace}/relay_esc", {})
    return Snapshot(
        times[f"{namespace}/vdp_plant"],
        int(plant["step"]),
        int(plant["late_ticks"]),
        int(lifter.get("state missed_steps", 0)) + int(controller.get("cost missed_steps", 0)),
        read(plant["round_trips"]),
        read(plant["ticks_behind"]),
    )


@dataclass(frozen=True)
class FleetReport:
    """A fleet between two reports of each of its loops.

    Attributes
    ----------
    rates : tuple of float
        Steps a second, by loop; 0 of a loop that is silent.
    steps, late, lost, unanswered : int
        Of all loops: steps done, periods without a tick, messages missed, states without a theta.
    round_trips, behind : Durations
        Of all loops.
    cpu : float
        Processor time of the containers as a share of one core.
    """

    rates: tuple[float, ...]
    steps: int
    late: int
    lost: int
    unanswered: int
    round_trips: Durations = field(repr=False)
    behind: Durations = field(repr=False)
    cpu: float

    @property
    def cpu_per_loop(self) -> float:
        """Processor time of a loop as a share of one core."""
        return self.cpu / len(self.rates)

    def p(self, share: float) -> float:
        """Return a percentile of the time from a state to its theta [s]."""
        return self.round_trips.quantile(share)


def report(before: Iterable[Snapshot], after: Iterable[Snapshot], cpu: float) -> FleetReport:
    """Return what happened between two snapshots of every loop."""
    pairs = list(zip(before, after, strict=True))
    steps = [late.step - early.step for early, late in pairs]
    trips = [late.round_trips.since(early.round_trips) for early, late in pairs]
    behind = [late.behind.since(early.behind) for early, late in pairs]
    return FleetReport(
        tuple(rate(early, late) for early, late in pairs),
        sum(steps),
        sum(late.late - early.late for early, late in pairs),
        sum(late.lost - early.lost for early, late in pairs),
        # the theta of the last state may be on its way
        sum(max(n - trip.count - 1, 0) for n, trip in zip(steps, trips, strict=True)),
        reduce(Durations.with_those_of, trips, Durations()),
        reduce(Durations.with_those_of, behind, Durations()),
        cpu,
    )


def rate(early: Snapshot, late: Snapshot) -> float:
    """Return the steps a second between two snapshots; 0 if there was no new report."""
    elapsed = late.time - early.time
    return (late.step - early.step) / elapsed if elapsed > 0.0 else 0.0
