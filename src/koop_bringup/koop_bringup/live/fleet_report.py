"""What a fleet did in a stretch of time, from what its nodes report on /diagnostics."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import reduce
from pathlib import Path

from koop_core.stream.durations import Durations, read

PERCENTILES = (0.5, 0.99, 0.999, 1.0)


@dataclass(frozen=True)
class Snapshot:
    """One report of the three nodes of a loop.

    Attributes
    ----------
    time : float
        When the plant said so, by its own clock [s].
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
    namespace: str, values: Mapping[str, Mapping[str, str]], said: Mapping[str, float]
) -> Snapshot:
    """Return the last report of a loop, from values and times by the nodes' full names."""
    plant = values[f"{namespace}/vdp_plant"]
    lifter = values.get(f"{namespace}/koopman_lifter", {})
    controller = values.get(f"{namespace}/relay_esc", {})
    return Snapshot(
        said[f"{namespace}/vdp_plant"],
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
        Steps a second, by loop.
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

    def text(self) -> str:
        """The report for people."""
        trip, behind = (
            ", ".join(
                f"{label} {each.quantile(share) * 1e3:.2f}"
                for label, share in zip(("p50", "p99", "p99.9", "most"), PERCENTILES, strict=True)
            )
            for each in (self.round_trips, self.behind)
        )
        rates = sorted(self.rates)
        return (
            f"rate             {rates[len(rates) // 2]:.2f} Hz in the middle, "
            f"{rates[0]:.2f} of the slowest loop\n"
            f"state -> theta   {trip} ms\n"
            f"ticks behind     {behind} ms\n"
            f"missed ticks     {self.late} of {self.steps + self.late}\n"
            f"lost messages    {self.lost}; states without a theta {self.unanswered}\n"
            f"CPU              {self.cpu_per_loop:.1%} of a core a loop, {self.cpu:.0%} together"
        )


def report(before: Iterable[Snapshot], after: Iterable[Snapshot], cpu: float) -> FleetReport:
    """Return what happened between two snapshots of every loop."""
    pairs = list(zip(before, after, strict=True))
    steps = [late.step - early.step for early, late in pairs]
    trips = [late.round_trips.since(early.round_trips) for early, late in pairs]
    behind = [late.behind.since(early.behind) for early, late in pairs]
    return FleetReport(
        tuple(n / (late.time - early.time) for n, (early, late) in zip(steps, pairs, strict=True)),
        sum(steps),
        sum(late.late - early.late for early, late in pairs),
        sum(late.lost - early.lost for early, late in pairs),
        # the theta of the last state may be on its way
        sum(max(n - trip.count - 1, 0) for n, trip in zip(steps, trips, strict=True)),
        reduce(Durations.with_those_of, trips, Durations()),
        reduce(Durations.with_those_of, behind, Durations()),
        cpu,
    )


def processor_time(process: int) -> float:
    """Return the processor time that a process has used [s]."""
    stat = Path(f"/proc/{process}/stat").read_text()
    user, system = stat.rpartition(")")[2].split()[11:13]  # fields 14 and 15, the name is the 2nd
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
