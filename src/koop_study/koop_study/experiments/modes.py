"""Experiment ``modes``: the Koopman modes over training seeds, beside the paper's."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from koop_study.experiments.seeds import Seeds
from koop_study.workers.units import Unit
from koop_view.report.document import Column, Figure, Panel, Section, Series, Table

# table 3: |lambda|; the last two are the pair 0.734663 +- 0.105522j, and the first and the fourth
# are the ones that the paper does not keep
PAPER = (
    1.000000, 0.999290, 0.999109, 0.998697, 0.989538, 0.937694, 0.896287, 0.848728, 0.742202,
    0.742202,
)  # fmt: skip
COLUMNS = (
    Column("rank", "mode", "d"),
    Column("paper", "|λ| paper", ".6f"),
    Column("median", "|λ| median", ".6f"),
    Column("least", "|λ| least", ".6f"),
    Column("largest", "|λ| largest", ".6f"),
    Column("difference", "median − paper", "+.6f"),
    Column("energy", "E_j median", ".3e"),
    Column("residual", "residual median", ".3f"),
    Column("kept", "kept [%]", ".0f"),
    Column("complex", "in a pair [%]", ".0f"),
)


@dataclass(frozen=True)
class ModesConfig:
    """Training seeds."""

    seeds: Seeds
    settings: dict[str, Any] = field(default_factory=dict)


def units(config: ModesConfig) -> list[Unit]:
    """Return one unit a training seed."""
    return [
        Unit("modes", {"settings": config.settings, "seed": seed}) for seed in config.seeds.list()
    ]


def section(config: ModesConfig, results: list[Any]) -> Section:
    """Return the part of the report."""
    every = {name: np.array([modes[name] for modes in results]) for name in results[0]}
    moduli = np.hypot(every["real"], every["imag"])
    count = moduli.shape[1]
    paper = [*PAPER, *[None] * count][:count]
    middle, least, largest = np.median(moduli, axis=0), moduli.min(axis=0), moduli.max(axis=0)
    cells = (
        range(1, count + 1),
        paper,
        middle.tolist(),
        least.tolist(),
        largest.tolist(),
        [None if p is None else m - p for m, p in zip(middle.tolist(), paper, strict=True)],
        np.median(every["energy"], axis=0).tolist(),
        np.median(every["residual"], axis=0).tolist(),
        (100.0 * every["kept"].mean(axis=0)).tolist(),
        (100.0 * (every["imag"] != 0.0).mean(axis=0)).tolist(),
    )
    title = f"Modes over {len(results)} training seeds, largest |λ| first"
    table = Table("modes_spread", title, COLUMNS, list(zip(*cells, strict=True)))
    ranks = [float(j) for j in range(count)]
    series = (
        Series("range over seeds", ranks, least.tolist(), "band", largest.tolist(), 0),
        Series("median", ranks, middle.tolist(), "line"),
        Series("paper", ranks[: len(PAPER)], PAPER[:count], "points", color=1),
    )
    panel = Panel("mode", "|λ|", series, ticks=tuple(str(j + 1) for j in range(count)))
    caption = "Moduli of the eigenvalues: range over the training seeds, median, and the paper's."
    return Section(
        "modes",
        "Koopman modes",
        "Eigenvalues of the EDMD operator on the ten monomials up to degree 3, learned from 100 "
        "corrupted trajectories, and the modes that the energy criterion keeps (paper, table 3).",
        [table],
        [Figure("modes", caption, (panel,))],
    )
