"""A coloured grid of numbers as a table of the page: to read, to copy, without a drawing."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence

from koop_view.report.document import Heat, Panel

# Viridis, light where the value is small; between the points linearly.
COLORS = ((253, 231, 37), (94, 201, 98), (33, 145, 140), (59, 82, 139), (68, 1, 84))
DARK = 0.45  # of the scale, from where on the numbers are white


def heat_table(panel: Panel, heat: Heat) -> str:
    """Return the grid as HTML, the last row of values on top as on an axis that points up."""
    head = "".join(f"<th>{html.escape(text)}</th>" for text in heat.x)
    rows = []
    for label, values in reversed(list(zip(heat.y, heat.values, strict=True))):
        cells = "".join(_cell(value, heat) for value in values)
        rows.append(f"<tr><th>{html.escape(label)}</th>{cells}</tr>")
    return (
        f'<table class="heat"><caption>rows: {html.escape(panel.y_label)}, columns: '
        f"{html.escape(panel.x_label)}</caption><thead><tr><th></th>{head}</tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table>"
    )


def _cell(value: float | None, heat: Heat) -> str:
    place = 1.0
    if value is not None:
        share = math.log(value / heat.low) / math.log(heat.high / heat.low)
        place = min(max(share, 0.0), 1.0)
    color = "#fff" if place > DARK else "#000"
    text = "–" if value is None else f"{value:.0f}"
    return f'<td style="background:rgb{_mixed(place)};color:{color}">{text}</td>'


def _mixed(place: float) -> tuple[int, ...]:
    spaces = len(COLORS) - 1
    left = min(int(place * spaces), spaces - 1)
    share = place * spaces - left
    pairs: Sequence[tuple[int, int]] = list(zip(COLORS[left], COLORS[left + 1], strict=True))
    return tuple(round(low + share * (high - low)) for low, high in pairs)
