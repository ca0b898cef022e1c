"""Contents of a bag as `koop bag info` prints them."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from koop_bag.bag.columns import LOG_TIME, iter_tables, list_fields
from koop_bag.bag.losses import LossCounter, StepReport, early_ends
from koop_bag.bag.reader import BagReader
from koop_bag.cdr.definition import has_step
from koop_bag.errors import BagError


@dataclass
class TopicInfo:
    """One topic."""

    name: str
    type_name: str
    count: int
    rate: float | None
    """Messages a second between the first and the last; None for fewer than two."""
    steps: StepReport | None
    """Losses by the steps; None for types without a step."""


@dataclass
class BagInfo:
    """One bag; the attributes are those that `koop bag info` prints."""

    path: str
    files: list[str]
    size: int
    complete: bool
    start: float
    duration: float
    messages: int
    topics: list[TopicInfo]
    model_ids: list[str]
    custom: dict[str, str]
    parameters: dict[str, dict[str, Any]]


def describe(bag: BagReader) -> BagInfo:
    """Read a bag through, in memory that does not grow with it."""
    counters: dict[str, LossCounter] = {}
    fields: dict[str, list[str]] = {}
    for topic in bag.topics:
        fields[topic.name] = [LOG_TIME]
        with suppress(BagError):  # without a definition that can be read, the times are known
            if "model_id" in list_fields(bag, topic.name):
                fields[topic.name].append("model_id")
            if has_step(topic.type_name, topic.definition):
                fields[topic.name].append("step")
                counters[topic.name] = LossCounter()
    spans: dict[str, tuple[int, int]] = {}
    models: dict[str, None] = {}
    for name, columns in iter_tables(bag, fields):
        times = columns[LOG_TIME]
        begin, end = spans.get(name, (2**64, 0))
        spans[name] = (min(begin, int(times.min())), max(end, int(times.max())))
        if name in counters:
            counters[name].add_many(columns["step"])
        models |= dict.fromkeys(columns.get("model_id", ()))
    topics = []
    for topic in bag.topics:
        counter = counters.get(topic.name) if topic.count else None
        if counter is not None:
            counter.inactive = min(bag.inactive_steps(topic.name), counter.lost)
            counter.lost -= counter.inactive
        begin, end = spans.get(topic.name, (0, 0))
        rate = (topic.count - 1) / ((end - begin) * 1e-9) if end > begin else None
        topics.append(TopicInfo(topic.name, topic.type_name, topic.count, rate, counter))
    return BagInfo(
        str(bag.path),
        [str(path) for path in bag.files],
        bag.size,
        bag.complete,
        bag.start_time * 1e-9,
        bag.duration,
        bag.message_count,
        topics=topics,
        model_ids=[model for model in models if model],
        custom=bag.custom_data(),
        parameters=bag.parameters,
    )


def as_text(info: BagInfo, with_parameters: bool = False) -> str:
    """Return the description for people."""
    begin = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(info.start))
    state = "complete" if info.complete else "torn: `koop bag recover` makes a whole bag of it"
    per_message = f", {info.size / info.messages:.1f} B a message" if info.messages else ""
    lines = [
        f"bag       {info.path} ({state})",
        f"files     {len(info.files)}, {info.size} B{per_message}",
        f"time      {begin}, {info.duration:.3f} s",
        f"messages  {info.messages}",
    ]
    if info.model_ids:
        lines.append(f"model     {', '.join(info.model_ids)}")
    if revision := info.custom.get("git_revision"):
        lines.append(f"revision  {revision}")
    if info.parameters:
        lines.append(f"nodes     {', '.join(info.parameters)}")
    width = max((len(topic.name) for topic in info.topics), default=5)
    lines += ["", f"{'topic':<{width}}  {'messages':>9}  {'Hz':>8}  {'lost':>6}  type"]
    ends = early_ends({t.name: t.steps.last for t in info.topics if t.steps is not None})
    for topic in info.topics:
        rate = "-" if topic.rate is None else f"{topic.rate:.1f}"
        lost = "-" if topic.steps is None else str(topic.steps.lost)
        lines.append(
            f"{topic.name:<{width}}  {topic.count:>9}  {rate:>8}  {lost:>6}  "
            f"{topic.type_name}{_remarks(topic.steps, ends.get(topic.name, 0))}"
        )
    if with_parameters:
        lines += ["", info.custom.get("parameters", "no parameters were recorded").rstrip()]
    return "\n".join(lines)


def _remarks(steps: StepReport | None, missing: int) -> str:
    if steps is None:
        return ""
    remarks = {
        f"begins at step {steps.first}": steps.first,
        f"{steps.duplicates} sent again": steps.duplicates,
        f"{steps.backward} steps back": steps.backward,
        f"{steps.jumps} jumps ahead: another publisher or a clock": steps.jumps,
        f"{steps.inactive} steps while inactive": steps.inactive,
        f"ends at step {steps.last}, {missing} before the loop": missing,
    }
    text = ", ".join(remark for remark, count in remarks.items() if count)
    return f" ({text})" if text else ""
