"""Verdicts in words: a line, a table."""

from __future__ import annotations

import math
from collections.abc import Sequence

from koop_hil.verdict import Verdict

WHOLE = 0.95  # of the duration: a busy machine lets simulated time fall behind
HEAD = (
    "| scenario | what happens | mean \\|θ − θ*\\| at the end | out of tolerance "
    "| max \\|θ − θ*\\| | oldest acting answer | recording | reported | verdict |\n"
    "|---|---|---|---|---|---|---|---|---|"
)


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


def table(verdicts: Sequence[Verdict]) -> str:
    """Return the verdicts as a Markdown table."""
    rows = [HEAD]
    for v in verdicts:
        levels = ", ".join(
            f"{node}: {'/'.join(level for level in levels if level != 'OK')}"
            for node, levels in v.levels.items()
            if set(levels) - {"OK"}
        )
        happens = "; ".join(v.events) or v.description
        recording = f"{v.unrecorded} missing" if v.unrecorded else "whole"
        failures = " ".join("; ".join(v.failures).split())
        verdict = "; ".join(["passed" if v.passed else f"**failed**: {failures}", *remarks(v)])
        if v.skipped:
            rows.append(f"| {v.name} | {happens} | | | | | | | skipped: {v.skipped} |")
            continue
        rows.append(
            f"| {v.name} | {happens} | {v.tail_error:.2f} | {v.time_out_of_tolerance:.1f} s | "
            f"{v.max_error:.2f} | {v.answer_age:.2f} s | {recording} | {levels or 'OK'} | "
            f"{verdict} |"
        )
    return "\n".join(rows) + "\n"
