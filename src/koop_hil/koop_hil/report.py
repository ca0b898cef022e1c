"""Verdicts for people (a table) and for continuous integration (JUnit XML)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from xml.etree import ElementTree

from koop_hil.verdict import Verdict

HEAD = (
    "| scenario | what happens | mean \\|θ − θ*\\| at the end | θ wrong for | θ off by at most "
    "| recording | reported | verdict |\n|---|---|---|---|---|---|---|---|"
)


def line(verdict: Verdict) -> str:
    """Return one verdict as a line."""
    if verdict.skipped:
        return f"{verdict.name:<24} skipped: {verdict.skipped}"
    state = "passed" if verdict.passed else "FAILED"
    return (
        f"{verdict.name:<24} {state}  mean |theta - theta*| {verdict.tail_error:.2f} at the end, "
        f"wrong for {verdict.wrong_for:.1f} s, by at most {verdict.wrong_by:.2f}"
    )


def growth(verdict: Verdict) -> str:
    """Return how memory and latency changed, as a line."""
    slopes = ", ".join(f"{node} {slope:+.2f}" for node, slope in verdict.memory_slope.items())
    first, last = verdict.round_trip
    return f"    memory [MB/h]: {slopes}; state to theta: {first:.2f} ms, at the end {last:.2f} ms"


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
        verdict = "passed" if v.passed else "**failed**: " + " ".join("; ".join(v.failures).split())
        if v.skipped:
            rows.append(f"| {v.name} | {happens} | | | | | | skipped: {v.skipped} |")
            continue
        rows.append(
            f"| {v.name} | {happens} | {v.tail_error:.2f} | {v.wrong_for:.1f} s | "
            f"{v.wrong_by:.2f} | {recording} | {levels or 'OK'} | {verdict} |"
        )
    return "\n".join(rows) + "\n"


def write_junit(verdicts: Iterable[Verdict], path: Path) -> None:
    """Write the verdicts as JUnit XML."""
    verdicts = list(verdicts)
    suite = ElementTree.Element(
        "testsuite",
        name="koop.hil",
        tests=str(len(verdicts)),
        failures=str(sum(bool(verdict.failures) for verdict in verdicts)),
        skipped=str(sum(bool(verdict.skipped) for verdict in verdicts)),
        errors="0",
        time=f"{sum(verdict.wall_time for verdict in verdicts):.3f}",
    )
    for verdict in verdicts:
        case = ElementTree.SubElement(
            suite,
            "testcase",
            classname="koop.hil",
            name=verdict.name,
            time=f"{verdict.wall_time:.3f}",
        )
        if verdict.skipped:
            ElementTree.SubElement(case, "skipped", message=verdict.skipped)
            continue
        properties = ElementTree.SubElement(case, "properties")
        for name in ("tail_error", "wrong_for", "wrong_by", "unrecorded"):
            ElementTree.SubElement(
                properties, "property", name=name, value=f"{getattr(verdict, name):.4g}"
            )
        if not verdict.passed:
            failure = ElementTree.SubElement(case, "failure", message=verdict.failures[0])
            failure.text = "\n".join(verdict.failures)
    ElementTree.indent(suite)
    ElementTree.ElementTree(suite).write(path, encoding="utf-8", xml_declaration=True)
