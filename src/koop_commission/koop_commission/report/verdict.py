"""Result of a commissioning: the verdict, and each stage with its next command."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from koop_commission.report.contents import Contents
from koop_tune.excitation.design import FLAT, KNOWN
from koop_tune.search.agreement import spell
from koop_tune.search.rounds import kept_index

DONE, MISSING, NO = "done", "missing", "no"


class Stage(NamedTuple):
    """A stage: its name, its state, and its result or the command that makes it."""

    name: str
    state: str
    text: str


def list_stages(c: Contents) -> Iterator[Stage]:
    """Yield all stages in order."""
    folder, rig, state = c.folder, c.rig_file, c.excitation
    yield Stage("Rig", DONE, f"{', '.join(c.rig.names)} measured; theta on {c.rig.command_topics}")
    text = f"{len(state.done)} holds in {state.elapsed:.0f} s"
    if not state.ended:
        yield Stage("Excite", MISSING, f"{text}; to resume: ./koop excite {rig} --out {folder}")
    else:
        over = {KNOWN: "the map is known", FLAT: "nothing reacts"}.get(state.ended)
        over = over or state.describe_end(c.rig)
        yield Stage("Excite", DONE if state.ended == KNOWN else NO, f"{text}: {over}")
    if controller := c.tuned.controller:
        yield Stage("Tune", DONE, f"cost {controller.cost}, law {controller.constants.law}")
    elif c.tuned.is_refused:
        yield Stage("Tune", NO, f"refused: {c.tuned.verdict}")
    else:
        yield Stage("Tune", MISSING, f"./koop tune {rig} {folder}")
    rounds, finished = c.verification.rounds, c.verification.finished
    if not rounds:
        command = f"./koop verify {rig} {folder}" if controller else "needs a controller"
        yield Stage("Verify", MISSING, command)
    elif len(finished) < len(rounds):
        yield Stage("Verify", MISSING, f"round {rounds[-1].number}: not finished")
    else:
        kept = finished[kept_index(finished, c.rig.sense)]
        yield Stage("Verify", DONE if kept.damped else NO, f"round {kept.number}: {kept.summary}")


def write_sentences(c: Contents) -> list[str]:
    """Return the verdict: of the verification, once there is one, else of what is known."""
    if verdict := c.verification.verdict.strip():
        return verdict.splitlines()
    return [_describe_rig(c), _describe_controller(c)]


def _describe_rig(c: Contents) -> str:
    rig, state = c.rig, c.excitation
    held, every = (
        [(math.exp(hold.level), hold.theta) for hold in holds if state.amplitude is not None]
        for holds in (state.holds, state.done)
    )
    span = f"theta from {rig.spell('theta_min')} to {rig.spell('theta_max')}"
    if not held:
        return f"The oscillation over {span} is not known yet."
    best, theta = min(held, key=lambda pair: rig.sense * pair[0])
    worst, far = max(every, key=lambda pair: rig.sense * pair[0])
    at = spell(theta)
    valley = ""
    if c.tuned.controller and (fit := c.tuned.static_map):  # the least hold is that by chance
        aim = c.tuned.make_aim(rig)
        best, at = math.exp(fit.best), aim.theta
        low, high = (spell([knob.valley[end] for knob in aim.knobs]) for end in (0, 1))
        valley = f"; its valley is from {low} to {high}"
    return (
        f"Over {span} the amplitude of {c.feature} is between {best:.3g} at {at} and "
        f"{worst:.3g} at {spell(far)}{valley}."
    )


def _describe_controller(c: Contents) -> str:
    if c.tuned.is_refused:
        return f"No controller ({c.tuned.verdict}): {c.tuned.why.rstrip('.')}."
    if (controller := c.tuned.controller) is None:
        return "Cost and constants are not chosen yet."
    predicted, doubt = controller.predicted, controller.doubt and f" In doubt: {controller.doubt}."
    return (
        f"The cost {controller.cost} with the law {controller.constants.law} is predicted to "
        f"converge in {predicted.converges.as_text()} s and to stay within a factor of "
        f"{predicted.excess.as_text()} of the best amplitude.{doubt}"
    )
