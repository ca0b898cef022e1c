"""Parameters that each knob has: one number for all of them, or one for each."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

from koop_core.config.parameter import ConfigError, Settings, spec_of

MOST = 8  # knobs of a controller
Configured = TypeVar("Configured", bound="KnobSettings")


@dataclass(frozen=True)
class KnobSettings(Settings):
    """Base of configurations with parameters of each knob (``per_knob`` of their Spec).

    With one knob such a field is a number. ConfigError is raised if lists differ in length.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        lengths = {len(value) for value in self._of_knobs().values() if isinstance(value, tuple)}
        if len(lengths) > 1 or max(lengths, default=1) > MOST:
            given = {name: value for name, value in self._of_knobs().items() if value != 0.0}
            raise ConfigError(
                f"{', '.join(f'{name} = {value}' for name, value in given.items())}: "
                f"each must be one number, or one for each of at most {MOST} knobs"
            )

    def _of_knobs(self) -> dict[str, Any]:
        return {
            item.name: getattr(self, item.name)
            for item in fields(self)
            if "spec" in item.metadata and spec_of(item).per_knob
        }

    @property
    def count(self) -> int:
        """Number of knobs."""
        return max(len(v) if isinstance(v, tuple) else 1 for v in self._of_knobs().values())

    def each(self, name: str) -> tuple[float, ...]:
        """Return a parameter of each knob."""
        value = getattr(self, name)
        return value if isinstance(value, tuple) else (value,) * self.count

    def knob(self: Configured, i: int, **others: Any) -> Configured:
        """Return the configuration of one knob alone, with ``others`` changed."""
        own = {k: v[i] if isinstance(v, tuple) else v for k, v in self._of_knobs().items()}
        return replace(self, **{**own, **others})

    def knobs(self: Configured, **others: Any) -> list[Configured]:
        """Return the configurations of the knobs, one each."""
        return [self.knob(i, **others) for i in range(self.count)]


def format_knobs(values: Iterable[float], spec: str = ".6g") -> str:
    """Return the value of one knob, or those of several in brackets.

    >>> format_knobs([2.0]), format_knobs([2.0, -1.0])
    ('2', '[2, -1]')
    """
    texts = [format(value, spec) for value in values]
    return texts[0] if len(texts) == 1 else f"[{', '.join(texts)}]"


def read_knobs(text: str) -> list[float]:
    """Return the values of knobs; the opposite of :func:`format_knobs`."""
    return [float(word) for word in text.strip("[]").split(",")]
