"""The verdict on a scenario, from its recording and from what the nodes reported."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.columns import read_tables
from koop_bag.bag.losses import count_losses
from koop_bag.bag.reader import BagReader
from koop_hil.scenario import Scenario
from koop_hil.supervisor import RunRecord
from koop_loop.metrics import TAIL
from vdp_plant.config import PlantConfig


@dataclass
class Verdict:
    """Figures of a run and what failed.

    Attributes
    ----------
    tail_error : float
        Mean |theta - theta*| over the last 30 %.
    time_out_of_tolerance : float
        Simulated time [s] from the first event on with theta out of tolerance.
    max_error : float
        Largest |theta - theta*| from the first event on.
    messages : dict
        Recorded messages by topic.
    unrecorded : int
        Messages that must have been there but are not in the bag: of steps that were jumped
        over, states whose cost, and costs whose theta was recorded.
    memory_slope : dict
        Growth of the resident memory of every process over the second half [MB/h].
    round_trip : tuple of float
        Median time from state to theta in the first and in the last third [ms].
    levels : dict
        Levels reported on /diagnostics.
    failures : list of str
        What did not hold; empty if the scenario passed.
    skipped : str
        Why the scenario cannot run here; empty if it ran.
    """

    name: str
    description: str
    events: list[str]
    tail_error: float = math.nan
    time_out_of_tolerance: float = math.nan
    max_error: float = math.nan
    messages: dict[str, int] = field(default_factory=dict)
    unrecorded: int = 0
    memory_slope: dict[str, float] = field(default_factory=dict)
    round_trip: tuple[float, float] = (math.nan, math.nan)
    levels: dict[str, list[str]] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)
    skipped: str = ""

    @property
    def passed(self) -> bool:
        """True if the scenario ran and all limits held."""
        return not self.failures and not self.skipped

    def as_dict(self) -> dict[str, Any]:
        """Return the verdict in JSON terms."""
        return {**asdict(self), "passed": self.passed}

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> Verdict:
        """Return the verdict that :meth:`as_dict` gave, also after it was written as JSON."""
        names = {item.name for item in fields(cls)}
        verdict = cls(**{key: value for key, value in content.items() if key in names})
        first, last = verdict.round_trip
        verdict.round_trip = (first, last)
        return verdict


def judge(scenario: Scenario, record: RunRecord, bag: Path) -> Verdict:
    """Compare a run with the scenario's limits."""
    events = [str(event) for event in scenario.events]
    verdict = Verdict(scenario.name, scenario.setting.description, events)
    verdict.levels = {node: sorted(levels) for node, levels in sorted(record.levels.items())}
    verdict.failures += record.crashed
    for node, level in scenario.levels.items():
        if level not in record.levels.get(node, set()):
            verdict.failures.append(f"{node} did not report {level}")
    for log in sorted((bag.parent / "logs").glob("*.log")):
        if "Traceback" in log.read_text(errors="replace"):
            verdict.failures.append(f"{log.name} holds a traceback")
    _look_for_growth(record, verdict)
    for node, slope in verdict.memory_slope.items():
        if slope > scenario.limits.memory_slope:
            verdict.failures.append(f"the memory of {node} grows by {slope:.1f} MB/h")
    stamps, theta = _recorded(bag, verdict)
    if verdict.unrecorded > scenario.limits.unrecorded:
        verdict.failures.append(f"{verdict.unrecorded} messages are missing in the recording")
    inside = (stamps >= record.begin) & (stamps <= record.end)
    stamps, theta = stamps[inside], theta[inside]
    if stamps.size < 100:
        verdict.failures.append(f"only {stamps.size} thetas recorded")
        return verdict
    error = np.abs(theta - scenario.setting.theta_star)
    verdict.tail_error = float(error[-max(1, round(TAIL * error.size)) :].mean())
    first = min((begin for begin, _, _ in record.happened), default=record.begin)
    after = stamps >= first
    out = after & (error > scenario.limits.error_limit)
    verdict.time_out_of_tolerance = float(out.sum() * PlantConfig().dt)
    verdict.max_error = float(error[after].max())
    for figure in ("tail_error", "time_out_of_tolerance", "max_error"):
        value, limit = getattr(verdict, figure), getattr(scenario.limits, figure)
        if not value <= limit:
            verdict.failures.append(f"{figure} = {value:.2f} is above {limit:g}")
    return verdict


def _look_for_growth(record: RunRecord, verdict: Verdict) -> None:
    """Fill in how memory and round trip changed; the first half is start-up."""
    late = record.memory[len(record.memory) // 2 :]
    for node in late[0][1] if len(late) > 10 else ():
        points = np.array([(t, sizes[node]) for t, sizes in late if node in sizes])
        if len(points) > 10:
            verdict.memory_slope[node] = float(np.polyfit(points[:, 0], points[:, 1], 1)[0] * 3600)
    trips = [value for _, value in record.round_trip if math.isfinite(value)]
    third = len(trips) // 3
    if third:
        verdict.round_trip = (float(np.median(trips[:third])), float(np.median(trips[-third:])))


def _recorded(bag: Path, verdict: Verdict) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return receive times [ns] and the theta that acted on the plant; count what is missing."""
    wanted = {f"/{name}": ["step"] for name in ("state", "cost", "theta")}
    with BagReader(bag) as reader:
        verdict.messages = {topic.name: topic.count for topic in reader.topics}
        wanted = {topic: fields for topic, fields in wanted.items() if topic in verdict.messages}
        columns = read_tables(
            reader, {**wanted, "/ground_truth": ["step", "log_time", "theta_applied"]}
        )
    ground_truth = columns["/ground_truth"]
    steps = {topic: np.unique(columns[topic]["step"]) for topic in wanted}
    verdict.unrecorded = count_losses(ground_truth["step"]).lost + sum(
        np.setdiff1d(steps[answer], steps[question]).size
        for question, answer in (("/state", "/cost"), ("/cost", "/theta"))
        if answer in steps and question in steps
    )
    return ground_truth["log_time"].astype(np.int64), ground_truth["theta_applied"].astype(
        np.float64
    )
