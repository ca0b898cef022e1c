"""Verdicts in words."""

from __future__ import annotations

import math

from koop_hil.verdict import Verdict

WHOLE = 0.95  # of the duration: a busy machine lets simulated time fall behind


def line(verdict: Verdict) -> str:
    """Return one verdict as a line."""
    if verdict.skipped:
        return f"{verdict.name:<24} skipped: {verdict.skipped}"
    state = "passed" if verdict.passed else "FAILED"
    if not verdict.messages:
        return f"{verdict.name:<24} {state}"
    out = verdict.time_out_of_tolerance
    figures = (
        f"mean |theta - theta*| {verdict.tail_error:.2f} at the end, "
        f"at most {verdict.max_error:.2f}, out of tolerance for {out:.1f} s, "
        f"oldest acting answer {verdict.answer_age:.2f} s"
    )
    return f"{verdict.name:<24} {state}  {', '.join([figures, *remarks(verdict)])}"


def remarks(verdict: Verdict) -> list[str]:
    """Return remarks on what is unusual about a run."""
    notes = []
    if verdict.simulated < WHOLE * verdict.duration:
        notes.append(f"theta known for {verdict.simulated:.0f} of {verdict.duration:.0f} s")
    notes += [f"{count} answers of {name}" for name, count in verdict.answers.items()]
    if verdict.contested:
        notes.append(f"{verdict.contested} answers with two controllers or none")
    return notes


def growth(verdict: Verdict) -> str:
    """Return how memory and latency changed, as a line."""
    slopes = ", ".join(f"{node} {slope:+.2f}" for node, slope in verdict.memory_slope.items())
    first, last = verdict.round_trip
    reported = math.isfinite(first) and math.isfinite(last)
    times = f"{first:.2f} ms, at the end {last:.2f} ms" if reported else "not reported by this rig"
    return f"    memory [MB/h]: {slopes}; state to theta: {times}"
