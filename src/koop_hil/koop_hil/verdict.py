"""The verdict on a scenario, from its recording and from what the nodes reported."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from koop_bag.bag.columns import Columns, read_tables
from koop_bag.bag.losses import count_losses
from koop_bag.bag.reader import BagReader
from koop_hil.answers import age_acting
from koop_hil.scenario import NO_LIMIT, Scenario
from koop_hil.supervisor import RunRecord
from koop_loop.settings import METRICS

FIELDS = {
    "state": ["step", "publish_time"],
    "cost": ["step"],
    "theta": ["step"],
    "ground_truth": ["step", "log_time", "publish_time", "theta_step"],
}
LIMITED = ("tail_error", "max_error", "unrecorded", "answer_age")


@dataclass
class Verdict:
    """Figures of a run and what failed."""

    name: str
    description: str
    events: list[str]
    tail_error: float = math.nan
    """Mean |theta - theta*| over the last 30 %."""
    time_out_of_tolerance: float = math.nan
    """Simulated time [s] from the first event on with theta out of tolerance."""
    max_error: float = math.nan
    """Largest |theta - theta*| from the first event on."""
    messages: dict[str, int] = field(default_factory=dict)
    """Recorded messages by topic."""
    unrecorded: int = 0
    """Messages that must have been there but are not in the bag: of steps that were jumped over,
    states whose cost, and costs whose theta was recorded."""
    duration: float = math.nan
    simulated: float = math.nan
    """Simulated time [s] that was asked for, and for which theta on the plant is known."""
    answer_age: float = math.nan
    """Largest age of a state [s of real time] when the answer to it began to act on the plant."""
    levels: dict[str, list[str]] = field(default_factory=dict)
    """Levels reported on /diagnostics."""
    failures: list[str] = field(default_factory=list)
    """What did not hold; empty if the scenario passed."""
    skipped: str = ""
    """Why the scenario cannot run here; empty if it ran."""

    @property
    def passed(self) -> bool:
        """True if the scenario ran and all limits held."""
        return not self.failures and not self.skipped

    def __str__(self) -> str:
        if self.skipped:
            return f"{self.name:<24} skipped: {self.skipped}"
        state = "passed" if self.passed else "FAILED"
        if not self.messages:
            return f"{self.name:<24} {state}"
        out = self.time_out_of_tolerance
        figures = (
            f"mean |theta - theta*| {self.tail_error:.2f} at the end, "
            f"at most {self.max_error:.2f}, out of tolerance for {out:.1f} s, "
            f"oldest acting answer {self.answer_age:.2f} s, "
            f"theta known for {self.simulated:.0f} of {self.duration:.0f} s"
        )
        return f"{self.name:<24} {state}  {figures}"


def judge(scenario: Scenario, record: RunRecord, bag: Path) -> Verdict:
    """Compare a run with the scenario's limits."""
    events = [str(event) for event in scenario.events]
    verdict = Verdict(scenario.name, scenario.setting.description, events)
    verdict.duration = scenario.setting.duration
    verdict.levels = {node: sorted(levels) for node, levels in sorted(record.levels.items())}
    verdict.failures += record.failures
    for node, level in scenario.levels.items():
        if level not in record.levels.get(node, set()):
            verdict.failures.append(f"{node} did not report {level}")
    for log in sorted((bag.parent / "logs").glob("*.log")):
        if "Traceback" in log.read_text(errors="replace"):
            verdict.failures.append(f"{log.name} holds a traceback")
    applied = [f"theta_applied[{i}]" for i in range(scenario.setting.count)]
    recorded = _read(bag, verdict, applied)
    for name in ("state", "cost", "theta"):
        if name not in recorded:
            verdict.failures.append(f"nothing was recorded on '{name}'")
            return verdict
    steps = {name: np.unique(recorded[name]["step"]) for name in ("state", "cost", "theta")}
    verdict.unrecorded += sum(
        np.setdiff1d(steps[answer], steps[question]).size
        for question, answer in (("state", "cost"), ("cost", "theta"))
    )
    verdict.answer_age = age_acting(recorded["state"], recorded["ground_truth"])
    _judge_theta(scenario, record, recorded["ground_truth"], applied, verdict)
    for figure in LIMITED:
        value, limit = getattr(verdict, figure), getattr(scenario.limits, figure)
        if value > limit or (math.isnan(value) and limit < NO_LIMIT):
            verdict.failures.append(f"{figure} = {value:.4g} is above {limit:g}")
    return verdict


def _judge_theta(
    scenario: Scenario, record: RunRecord, ground_truth: Columns, applied: list[str],
    verdict: Verdict,
) -> None:  # fmt: skip
    """Fill in how far from the optimum the theta was that acted on the plant."""
    stamps = ground_truth["log_time"].astype(np.int64)
    inside = (stamps >= record.begin) & (stamps <= record.end)
    stamps = stamps[inside]
    theta = np.stack([ground_truth[name][inside] for name in applied], axis=1)
    verdict.simulated = float(stamps.size * scenario.dt)
    if verdict.simulated < scenario.limits.covered * verdict.duration:
        verdict.failures.append(f"theta is known for only {verdict.simulated:.1f} s of the run")
        return
    error = scenario.off(theta)
    verdict.tail_error = float(error[-max(1, round(METRICS.tail * error.size)) :].mean())
    after = stamps >= record.first
    out = after & (error > scenario.limits.error_limit)
    verdict.time_out_of_tolerance = float(out.sum() * scenario.dt)
    verdict.max_error = float(error[after].max(initial=0.0))


def _read(bag: Path, verdict: Verdict, applied: list[str]) -> dict[str, Columns]:
    """Return what is judged of every topic that was recorded."""
    topics = {f"/{name}": name for name in FIELDS}
    with BagReader(bag) as reader:
        verdict.messages = {topic.name: topic.count for topic in reader.topics}
        wanted = {
            topic: FIELDS[name] + applied * (name == "ground_truth")
            for topic, name in topics.items()
            if verdict.messages.get(topic) or name == "ground_truth"
        }
        recorded = {topics[name]: table for name, table in read_tables(reader, wanted).items()}
        jumped = count_losses(recorded["ground_truth"]["step"]).lost
        # steps that passed while the plant or the recorder was inactive are not lost
        verdict.unrecorded = max(0, jumped - reader.inactive_steps("/ground_truth"))
    return recorded
