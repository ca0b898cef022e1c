"""How the figures draw values."""

from __future__ import annotations

from collections.abc import Sequence

MEASURED, INTERFERENCE, BEST, OTHER, FAINT = 0, 1, 2, 3, 7  # positions in the page's palette


def step_apart(x: Sequence[float], span: float = 0.0) -> list[float]:
    """Return rising values with those that are equal a little apart: each is drawn.

    ``span`` is the range of the axis; that of the values unless given.
    """
    step, result = 1e-4 * (span or x[-1] - x[0]), list(x)
    for k in range(1, len(result)):
        result[k] = max(result[k], result[k - 1] + step)
    return result
