"""Parts of a page: tables, figures, and sentences that cite the tables."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

Cell = str | float | int | None


def shown(value: Cell, form: str = ".4g") -> str:
    """Return a cell as the report and the sentences print it."""
    if value is None:
        return "–"
    if isinstance(value, str):
        return value
    if not math.isfinite(value):
        return "diverged" if math.isinf(value) else "–"
    return format(value, form)


@dataclass(frozen=True)
class Column:
    """A column of a table: ``key`` in the CSV, ``title`` on the page, number format, or words."""

    key: str
    title: str
    form: str = ".4g"
    words: bool = False


@dataclass
class Table:
    """A table of a page; the study writes it as a CSV file, too."""

    name: str
    """File name without suffix, and what sentences cite."""
    title: str
    """Caption."""
    columns: tuple[Column, ...]
    """The first one names the row."""
    rows: list[tuple[Cell, ...]] = field(default_factory=list)
    """Cells in the order of the columns."""
    detail: bool = False
    """True if the report folds the table away."""

    def cell(self, row: Cell, column: str) -> str:
        """Return the text of one cell; ``row`` is the content of its first column.

        Raises
        ------
        KeyError
            If there is no such row or column.
        """
        index = [item.key for item in self.columns].index(column)
        for cells in self.rows:
            if cells[0] == row:
                return shown(cells[index], self.columns[index].form)
        raise KeyError(f"table {self.name} has no row {row!r}")

    def texts(self) -> list[list[str]]:
        """Return every cell as the report shows it."""
        forms = [column.form for column in self.columns]
        return [[shown(c, f) for c, f in zip(row, forms, strict=True)] for row in self.rows]

    def csv(self) -> str:
        """Return the table as CSV, ten significant digits, empty where there is no value."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([column.key for column in self.columns])
        for row in self.rows:
            writer.writerow([_exact(cell) for cell in row])
        return text.getvalue()


def _exact(cell: Cell) -> str:
    if cell is None:
        return ""
    return format(cell, ".10g") if isinstance(cell, float) else str(cell)


@dataclass(frozen=True)
class Series:
    """One curve."""

    name: str
    """A curve and a band of the same name share a row of the legend."""
    x: Sequence[float]
    y: Sequence[float | None]
    """Shape (M,): ``x`` rises or falls; NaN or None in ``y`` where there is no value."""
    kind: str = "line"
    """``line``, ``points``, ``steps``, ``band`` (between ``y`` and ``upper``), ``bars`` (the same
    as error bars), or ``level``: a dashed line at a value to compare with."""
    upper: Sequence[float | None] = ()
    """Shape (M,): upper edge; for a band and for bars only."""
    color: int = 0
    """Position in the page's palette."""


@dataclass(frozen=True)
class Mark:
    """A place on the x axis with its name, and between what it may be."""

    x: float
    name: str
    low: float | None = None
    high: float | None = None
    color: int = 0


@dataclass(frozen=True)
class Panel:
    """One pair of axes.

    ``ticks`` are the names of the positions 0, 1, 2... on the x axis; with ``time``, x counts whole
    seconds since the epoch.
    """

    x_label: str
    y_label: str
    series: tuple[Series, ...] = ()
    title: str = ""
    log_x: bool = False
    log_y: bool = False
    ticks: tuple[str, ...] = ()
    marks: tuple[Mark, ...] = ()
    time: bool = False


@dataclass(frozen=True)
class Figure:
    """Panels that are read together; ``columns`` of them stand side by side if there is room."""

    name: str
    caption: str
    panels: tuple[Panel, ...]
    columns: int = 1


@dataclass(frozen=True)
class Claim:
    """A sentence whose every number is a cell of the table that is named."""

    text: str
    table: str


@dataclass
class Section:
    """One experiment's part of the report."""

    name: str
    title: str
    intro: str
    tables: list[Table] = field(default_factory=list)
    figures: list[Figure] = field(default_factory=list)
