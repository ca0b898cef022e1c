"""Experiment ``modes``: the Koopman modes beside the paper's, and their spread over seeds."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from koop_study.experiments.spec import Seeds
from koop_study.workers.units import Unit
from koop_view.report.document import Column, Figure, Panel, Section, Series, Table

PAPER = (  # table 3: real part, imaginary part, selected
    (1.000000, 0.0, False),
    (0.999290, 0.0, True),
    (0.999109, 0.0, True),
    (0.998697, 0.0, False),
    (0.989538, 0.0, True),
    (0.937694, 0.0, True),
    (0.896287, 0.0, True),
    (0.848728, 0.0, True),
    (0.734663, 0.105522, True),
    (0.734663, -0.105522, True),
)


@dataclass(frozen=True)
class ModesConfig:
    """Training seeds; the first one makes the table, all of them the spread."""

    seeds: Seeds
    settings: dict[str, Any] = field(default_factory=dict)


def units(config: ModesConfig) -> list[Unit]:
    """Return one unit a training seed."""
    return [
        Unit("modes", {"settings": config.settings, "seed": seed}) for seed in config.seeds.list()
    ]


def section(config: ModesConfig, results: list[Any]) -> Section:
    """Return the part of the report."""
    table = _table(results[0])
    moduli = np.array([np.hypot(found["real"], found["imag"]) for found in results])
    kept = np.array([found["kept"] for found in results])
    complex_ = np.array([np.array(found["imag"]) != 0.0 for found in results])
    spread = Table(
        "modes_spread",
        f"Modes over {len(results)} training seeds, largest |λ| first",
        (
            Column("rank", "mode", "d"),
            Column("paper", "|λ| paper", ".6f"),
            Column("median", "|λ| median", ".6f"),
            Column("least", "|λ| least", ".6f"),
            Column("largest", "|λ| largest", ".6f"),
            Column("difference", "median − paper", "+.6f"),
            Column("kept", "kept [%]", ".0f"),
            Column("complex", "in a pair [%]", ".0f"),
        ),
    )
    for j in range(moduli.shape[1]):
        paper = float(np.hypot(*PAPER[j][:2])) if j < len(PAPER) else None
        spread.rows.append(
            (
                j + 1,
                paper,
                float(np.median(moduli[:, j])),
                float(moduli[:, j].min()),
                float(moduli[:, j].max()),
                float(np.median(moduli[:, j])) - paper if paper is not None else None,
                100.0 * float(kept[:, j].mean()),
                100.0 * float(complex_[:, j].mean()),
            )
        )
    ranks = [float(j) for j in range(moduli.shape[1])]
    figure = Figure(
        "modes",
        "Moduli of the eigenvalues: range over the training seeds, median, and the paper's.",
        (
            Panel(
                "mode",
                "|λ|",
                (
                    Series(
                        "range over seeds", ranks, moduli.min(axis=0).tolist(), "band",
                        moduli.max(axis=0).tolist(), 0,
                    ),
                    Series("median", ranks, np.median(moduli, axis=0).tolist(), "line"),
                    Series(
                        "paper", ranks[: len(PAPER)],
                        [float(np.hypot(re, im)) for re, im, _ in PAPER], "points", color=1,
                    ),
                ),
                ticks=tuple(str(j + 1) for j in range(moduli.shape[1])),
            ),
        ),
    )  # fmt: skip
    return Section(
        "modes",
        "Koopman modes",
        "Eigenvalues of the EDMD operator on the ten monomials up to degree 3, learned from 100 "
        "corrupted trajectories, and the modes that the energy criterion keeps (paper, table 3).",
        [table, spread],
        [figure],
    )


def _table(found: dict[str, Any]) -> Table:
    table = Table(
        "modes",
        "Modes of the first training seed beside the paper's",
        (
            Column("rank", "mode", "d"),
            Column("eigenvalue", "λ"),
            Column("modulus", "|λ|", ".6f"),
            Column("energy", "E_j", ".3e"),
            Column("residual", "residual", ".3f"),
            Column("kept", "kept"),
            Column("paper_eigenvalue", "λ paper"),
            Column("paper_modulus", "|λ| paper", ".6f"),
            Column("paper_kept", "kept, paper"),
        ),
    )
    for j, (real, imag) in enumerate(zip(found["real"], found["imag"], strict=True)):
        paper = PAPER[j] if j < len(PAPER) else None
        table.rows.append(
            (
                j + 1,
                _complex(real, imag),
                float(np.hypot(real, imag)),
                found["energy"][j],
                found["residual"][j],
                "yes" if found["kept"][j] else "no",
                _complex(*paper[:2]) if paper else None,
                float(np.hypot(*paper[:2])) if paper else None,
                ("yes" if paper[2] else "no") if paper else None,
            )
        )
    return table


def _complex(real: float, imag: float) -> str:
    return f"{real:.6f}{imag:+.6f}j" if imag else f"{real:.6f}"
