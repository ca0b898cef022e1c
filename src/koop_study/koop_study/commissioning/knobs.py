"""One rig with several knobs commissioned: excited, tuned, verified from two opposite corners."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from koop_study.commissioning.excitation import excite, longest
from koop_study.commissioning.work import EARLIER, NEXT, Loops, commissioned
from koop_study.family.config import FamilyConfig
from koop_study.family.knobs import KnobsRig, draw_knobs
from koop_study.family.loop import ClosedRun, RigController, close, noise_of
from koop_study.family.rig import RandomRig
from koop_tune.excitation.bowl import find_starts
from koop_tune.excitation.design import KNOWN
from koop_tune.search.findings import NoOptimum


def commission_knobs(
    n: int, condition: float, useless: bool, family: dict[str, Any], seed: int, rate: float,
    excitation: float, duration: float, effort: float,
) -> dict[str, Any]:  # fmt: skip
    """Commission one rig with n knobs, in as many rounds as ``koop commission`` takes.

    Parameters
    ----------
    n, condition, useless, family, seed
        As of :func:`koop_study.family.knobs.draw_knobs`.
    rate, excitation, duration, effort
        As of :func:`koop_study.commissioning.work.commission_plant`, the times for each knob.

    Returns
    -------
    dict
        The verdict, the amplitude at the best hold over the true best, and that of the loops.
    """
    rig = draw_knobs(FamilyConfig(**family), seed, n, condition, useless)
    own, dt = rig.rig, rig.rig.params.dt
    file = rig.file(rate, n * longest(own, excitation))
    recorded = excite(own, file, seed + EARLIER, rig)
    design = recorded.design
    row: dict[str, Any] = {
        "seed": seed, "start": rig.excess(rig.start), "held": rig.excess(design.base),
        "holds": len(design.held), "excited": recorded.elapsed / own.time, "damped": False,
    }  # fmt: skip
    if design.ended != KNOWN or design.amplitude is None:
        return {**row, "verdict": design.ended or "time"}
    starts = find_starts(file, *design.arrays)
    loops = KnobsLoops(rig, starts, seed, n * round(duration * own.time / dt))
    try:
        tuning = commissioned(own, file, recorded, loops, seed, effort, row)
        return {**row, "verdict": "tuned", "why": tuning.why}
    except NoOptimum as no:
        return {**row, "verdict": no.kind, "why": str(no)}


class KnobsLoops(Loops):
    """The loop of a rig with several knobs closed from two opposite corners."""

    def __init__(
        self, rig: KnobsRig, starts: Sequence[tuple[float, ...]], seed: int, steps: int
    ) -> None:
        super().__init__(rig.rig, seed, steps)
        self._knobs, self._starts = rig, starts

    def later(self, number: int, longer: float, passed: int) -> KnobsLoops:
        """As of one knob; the optimum rests."""
        steps = round(longer * self._steps)
        return KnobsLoops(self._knobs, self._starts, self._seed + number * NEXT, steps)

    def _settled(self, count: int, theta: tuple[float, ...]) -> RandomRig:
        return self._knobs.starting_at(np.array(theta))

    def close(self, controller: RigController) -> list[ClosedRun]:
        """Close it with a controller."""
        closed = []
        start: Any
        for start in self._starts:
            begin = self._settled(0, start)
            from_there = replace(controller, esc=replace(controller.esc, theta_initial=start))
            noise = noise_of(begin, self._steps, self._seed)
            closed.append(close(begin, from_there, noise, self._seed, self._knobs))
        return closed
