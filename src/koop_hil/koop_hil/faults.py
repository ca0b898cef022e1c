"""Faults of a sensor or an actuator, named as PX4's failure injection names them.

    ok                                     nothing is wrong
    off                                    no message passes
    stuck [index=i]                        the value is held at the last good one
    garbage [kind=nan|inf|huge|short]      the value is not a measurement
    wrong [gain=g] [bias=b] [index=i]      the value is off
    slow [every=n]                         only every n-th message passes
    delayed [delay=s] [jitter=s]           messages come late; jitter lets them overtake each other
    intermittent [loss=p] [duplicate=p]    messages are lost or come twice at random

Pure: time is an argument, and a message is its step and its values.
"""

from __future__ import annotations

import heapq
import math
import random
from dataclasses import dataclass, field
from typing import Any

from koop_core.config.parameter import ConfigError

DEFAULTS: dict[str, dict[str, float | str]] = {
    "ok": {},
    "off": {},
    "stuck": {"index": -1},
    "garbage": {"kind": "nan"},
    "wrong": {"gain": 1.0, "bias": 0.0, "index": -1},
    "slow": {"every": 4},
    "delayed": {"delay": 0.0, "jitter": 0.0},
    "intermittent": {"loss": 0.0, "duplicate": 0.0},
}
KINDS = ("nan", "inf", "huge", "short")


@dataclass(frozen=True)
class Fault:
    """One fault with its settings."""

    name: str = "ok"
    settings: dict[str, Any] = field(default_factory=dict)

    def __getitem__(self, key: str) -> Any:
        return self.settings[key]


def parse(text: str) -> Fault:
    """Return the fault that ``name key=value ...`` describes.

    Raises ConfigError if there is no such fault or setting.
    """
    name, *words = text.split() or [""]
    if name not in DEFAULTS:
        raise ConfigError(f"unknown fault '{name}': choose {', '.join(DEFAULTS)}")
    settings = dict(DEFAULTS[name])
    for word in words:
        key, equals, value = word.partition("=")
        if not equals or key not in settings:
            names = ", ".join(settings) or "no settings"
            raise ConfigError(f"fault {name}: '{word}' is not a setting; it has {names}")
        if key == "kind":
            if value not in KINDS:
                raise ConfigError(f"fault {name}: kind must be one of {', '.join(KINDS)}")
            settings[key] = value
            continue
        try:
            number = settings[key] = float(value)
        except ValueError:
            raise ConfigError(f"fault {name}: {key} = '{value}' is not a number") from None
        low = -math.inf if key in ("gain", "bias", "index") else float(key == "every")
        if not low <= number < 1e9:
            raise ConfigError(f"fault {name}: {key} = {value} is out of range")
    return Fault(name, settings)


class Channel:
    """A line that messages pass, with the fault that is on it."""

    def __init__(self, seed: int = 0) -> None:
        self.fault = Fault()
        self._random = random.Random(seed)
        self._waiting: list[tuple[float, int, Any, list[float]]] = []
        self._count = 0
        self._last: list[float] = []

    def push(self, now: float, message: Any, values: list[float]) -> None:
        """Take a message [s]; what comes out is returned by :meth:`pop`."""
        fault, name = self.fault, self.fault.name
        self._count += 1
        due, copies = now, 1
        if name == "off" or (name == "slow" and self._count % max(1, int(fault["every"]))):
            return
        if name == "intermittent":
            if self._random.random() < fault["loss"]:
                return
            copies += self._random.random() < fault["duplicate"]
        elif name == "delayed":
            due += fault["delay"] + fault["jitter"] * self._random.random()
        elif name in ("stuck", "garbage", "wrong"):
            values = self._changed(fault, values)
        if name in ("ok", "delayed"):
            self._last = values
        for _ in range(copies):
            heapq.heappush(self._waiting, (due, self._count, message, values))

    def pop(self, now: float) -> list[tuple[Any, list[float]]]:
        """Return what has come through by now, in order: (message, values)."""
        out = []
        while self._waiting and self._waiting[0][0] <= now:
            _, _, message, values = heapq.heappop(self._waiting)
            out.append((message, values))
        return out

    def _changed(self, fault: Fault, values: list[float]) -> list[float]:
        if fault.name == "garbage":
            if fault["kind"] == "short":
                return values[:-1]
            garbage = {"nan": math.nan, "inf": math.inf, "huge": 1e300}[fault["kind"]]
            return [garbage] * len(values)
        chosen = range(len(values)) if fault["index"] < 0 else [int(fault["index"])]
        changed = list(values)
        for i in chosen:
            if i >= len(values):
                continue
            if fault.name == "wrong":
                changed[i] = fault["gain"] * values[i] + fault["bias"]
            elif i < len(self._last):
                changed[i] = self._last[i]
        return changed
