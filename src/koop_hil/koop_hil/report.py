"""Verdicts in words."""

from __future__ import annotations

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
    if verdict.simulated < WHOLE * verdict.duration:
        figures += f", theta known for {verdict.simulated:.0f} of {verdict.duration:.0f} s"
    return f"{verdict.name:<24} {state}  {figures}"
