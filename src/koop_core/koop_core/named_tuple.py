"""Named tuples with other values, in kernels as in Python."""

from __future__ import annotations

from typing import Any, TypeVar

State = TypeVar("State")


def replace(state: State, **changes: Any) -> State:
    """Return a named tuple with other values of some fields, as its ``_replace``; in kernels, too.

    A value must have its field's type: 0.0, not 0, for a float.
    """
    replaced: State = state._replace(**changes)  # type: ignore[attr-defined]
    return replaced
