"""Tables in Markdown files, between two markers that a command finds again."""

from __future__ import annotations

import re

from koop_view.report.document import Table


def markdown(table: Table) -> str:
    """Return a table as Markdown."""
    heads = [column.title for column in table.columns]
    lines = [heads, ["---"] * len(heads), *table.texts()]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def rewrite_block(text: str, block: str, markers: tuple[str, str]) -> str:
    """Return ``text`` with what stands between two markers replaced by ``block``.

    Raises
    ------
    ValueError
        If the markers are not there, once each and in order.
    """
    begin, end = markers
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise ValueError(f"needs one '{begin}' and, after it, one '{end}'")
    pattern = re.escape(begin) + ".*?" + re.escape(end)
    return re.sub(pattern, lambda _: f"{begin}\n{block}\n{end}", text, flags=re.DOTALL)
