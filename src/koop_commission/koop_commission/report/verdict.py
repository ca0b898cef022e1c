"""What a commissioning has come to: three sentences, and each stage with what is missing."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any, NamedTuple

from koop_commission.report.gathered import Gathered
from koop_tune.search.agreement import as_predicted, ended, kept_round

DONE, OPEN, NO = "done", "missing", "no"

NEXT = {
    "monotone": "Leave theta at the better limit, or widen that limit in the rig file and record "
    "again",
    "flat": "See with koop check whether theta reaches the rig, then record wider limits or "
    "longer stays (a larger 'time' in the rig file)",
    "drowned": "Record longer stays (a larger 'time' in the rig file), or measure where the "
    "oscillation is stronger",
}


class Stage(NamedTuple):
    """One stage: its name, whether it is done, and what it came to or what does it."""

    name: str
    state: str
    text: str


def stages(g: Gathered) -> Iterator[Stage]:
    """Yield all stages in order."""
    folder, rig, visits = g.folder, g.file, g.excited.visits
    yield Stage("Rig", DONE, f"{', '.join(g.rig.names)} measured; theta on {g.rig.knob.topic}")
    reached = len({visit.level for visit in visits})
    text = f"{len(visits)} stays at {reached} of {len(g.excited.values)} values of theta"
    if g.excitation_over:
        over = "" if g.excited.done else f"; the {g.rig.time:g} s were over"
        yield Stage("Excite", DONE, text + over)
    else:
        yield Stage("Excite", OPEN, f"{text}; ./koop excite {rig} --out {folder} goes on")
    if g.found:
        yield Stage("Tune", DONE, f"cost {g.tuned['cost']}, law {g.tuned['constants']['law']}")
    elif g.refused:
        yield Stage("Tune", NO, f"refused: {g.tuned['verdict']}")
    else:
        yield Stage("Tune", OPEN, f"./koop tune {rig} {folder}")
    if not g.rounds:
        how = f"./koop verify {rig} {folder}" if g.found else "needs a controller"
        yield Stage("Verify", OPEN, how)
        return
    if len(rounds := ended(g.rounds)) < len(g.rounds):
        yield Stage("Verify", OPEN, f"round {g.rounds[-1]['round']}: not at its end")
        return
    kept = rounds[kept_round(rounds)]
    good = as_predicted(kept)
    yield Stage("Verify", DONE if good else NO, f"round {kept['round']}: {kept['says']}")


def sentences(g: Gathered) -> list[str]:
    """Return the verdict: that of the verification, once there is one."""
    if said := str(g.verified.get("verdict", "")).strip():
        return re.split(r"(?<=\.) (?=[A-Z])", said)
    return [_of_rig(g), _of_controller(g), _of_proof(g)]


def _of_rig(g: Gathered) -> str:
    rig = g.rig
    span = f"theta from {rig.theta_min:g} to {rig.theta_max:g}"
    if g.tuned:
        found, feature = g.tuned["static_map"], g.tuned["feature"]
        theta, level = found["theta"], found["amplitude"]
    else:
        known = excited_map(g)
        if known is None:
            return f"Nothing is known of the oscillation over {span} yet."
        feature, theta, level, _ = known
    sense = 1.0 if rig.objective == "minimise" else -1.0
    order = sorted(range(len(level)), key=lambda i: sense * level[i])
    best, worst = order[0], order[-1]
    text = (
        f"Over {span} the amplitude of {feature} is between {level[best]:.3g} at "
        f"{theta[best]:.4g} and {level[worst]:.3g} at {theta[worst]:.4g}"
    )
    if g.found:
        low, high = g.tuned["theta_best_band"]
        text += f"; it is best near {g.tuned['theta_best']:.4g} ({low:.4g} to {high:.4g})"
    return text + "."


def _of_controller(g: Gathered) -> str:
    if g.refused:
        why = str(g.tuned["why"])
        return f"No controller was made ({g.tuned['verdict']}): {why.rstrip('.')}."
    if not g.found:
        return "No cost and no constants are chosen yet."
    p = g.tuned["predicted"]
    doubt = f" In doubt: {g.tuned['doubt']}." if g.tuned["doubt"] else ""
    return (
        f"The cost {g.tuned['cost']} with the law {g.tuned['constants']['law']} is predicted to "
        f"come near that within {told(p['converges'])} s and to stay within a factor of "
        f"{told(p['excess'])} of it.{doubt}"
    )


def _of_proof(g: Gathered) -> str:
    if g.refused:
        return NEXT.get(g.tuned["verdict"], "Record again") + "."
    if g.found:
        return f"It is not verified on the rig yet: ./koop verify {g.file} {g.folder}."
    if not g.excitation_over:
        return f"The excitation is not at its end: ./koop excite {g.file} --out {g.folder} goes on."
    return f"Next: ./koop tune {g.file} {g.folder}."


def told(band: dict[str, Any]) -> str:
    """Return a figure with its band in words; None is never."""

    def one(value: float | None) -> str:
        return "never" if value is None else f"{value:.3g}"

    return f"{one(band['middle'])} ({one(band['low'])} to {one(band['high'])})"


def excited_map(g: Gathered) -> tuple[str, list[float], list[float], list[float]] | None:
    """Return feature, theta, amplitude and error of the excitation's own map; None if none."""
    visits, how = g.excited.visits, g.excited.how
    if not visits or how is None:
        return None
    names = how.names(g.rig.names)
    feature, points = g.excited.map_of(range(len(names)))
    known = [(v, p) for v, p in zip(g.excited.values, points, strict=True) if p is not None]
    return (
        names[feature],
        [v for v, _ in known],
        [math.exp(p.mean) for _, p in known],
        [p.error if math.isfinite(p.error) else 0.0 for _, p in known],
    )
