"""The study in sentences from its tables, as a control engineer would tell a colleague.

A sentence whose table or row is not there, as of a study of some experiments only, is left out;
verdicts follow the figures.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from koop_study.experiments.cases import label
from koop_view.report.document import Claim, Section, Table
from koopman_lifter.config import LifterConfig
from relay_esc.config import EscConfig

COLUMNS = ("cost", "iae_median", "iae_p90", "t_theta_median", "converged", "e_r_ss_median")
METRICS = (
    ("θ, θ*", "the control input, and its best value, which the controller does not know"),
    ("IAE, ISE", "∫ |θ − θ*| dt and ∫ (θ − θ*)² dt [s], from t = 100 s on"),
    ("T", "first time with |θ − θ*| < 0.1 [s]; – if never"),
    (
        "e_r^ss",
        "|mean of r over the last 30 % − r*| / (max r − min r), where r is the cost and r* its "
        "mean with θ resting at θ*",
    ),
    ("converged", "the mean of |θ − θ*| over the last 30 % is at most 0.6"),
    (
        "raw, lifted, contrast",
        "the cost that the controller sees; the first two are the paper's",
    ),
)

Tables = Mapping[str, Table]


def by_name(sections: Sequence[Section]) -> dict[str, Table]:
    """Return the tables of all sections by name."""
    return {table.name: table for section in sections for table in section.tables}


def sentences(tables: Tables) -> list[Claim]:
    """Return the sentences that the tables carry, the most important first."""
    claims = []
    for name, write in SENTENCES:
        try:
            claims.append(Claim(write(tables[name]), name))
        except (KeyError, ValueError):  # no such table, row, column or figure
            continue
    return claims


def headline(tables: Tables) -> Table | None:
    """Return the few figures that the summary shows."""
    table = tables.get("robustness")
    if table is None:
        return None
    columns = {column.key: column for column in table.columns}
    keys = [column.key for column in table.columns]
    rows = [tuple(row[keys.index(name)] for name in COLUMNS) for row in table.rows]
    return Table("summary", table.title, tuple(columns[name] for name in COLUMNS), rows)


def _the_papers_claim(table: Table) -> str:
    lifted, raw = (table.cell(cost, "iae_median") for cost in ("lifted", "raw"))
    verdict = "holds" if _number(lifted) < _number(raw) else "does not hold"
    return (
        f"At our default constants the paper's claim {verdict}: seeking on the lifted cost comes "
        f"to a median IAE, the integral of |θ − θ*|, of {lifted}, on the raw cost to {raw}, and "
        f"lifted is ahead with {table.cell('lifted', 'win_rate')} % of the seeds."
    )


def _rows(table: Table, cost: str) -> list[dict[str, str]]:
    """Return the rows of a cost, each by the column's key."""
    keys = [column.key for column in table.columns]
    rows = [dict(zip(keys, texts, strict=True)) for texts in table.texts()]
    return [row for row in rows if row["cost"] == cost]


def _the_open_constants(table: Table) -> str:
    best = min(_rows(table, "raw"), key=lambda row: _number(row["iae_median"]))
    usual = label([LifterConfig.omega_h, LifterConfig.omega_l, EscConfig.tau_f])
    (default,) = (row["iae_median"] for row in _rows(table, "lifted") if row["value"] == usual)
    verdict = "beats" if _number(best["iae_median"]) < _number(default) else "does not beat"
    return (
        "But the paper leaves three filter constants open, and they matter as much as the lifting: "
        f"with its best choice of them the raw cost {verdict} the lifted one at the defaults, "
        f"{best['iae_median']} against {default}, and {best['converged']} % of its runs converge."
    )


def _convexity(table: Table) -> str:
    raw, lifted = (table.cell(f"{cost}, settled", "convexity") for cost in ("raw", "lifted"))
    verdict = "is more convex" if _number(lifted) > _number(raw) else "is not more convex"
    return (
        f"The settled map r(θ) {verdict} when lifted, which is the paper's explanation: {lifted} % "
        f"of its second differences are positive, of the raw map's {raw} %."
    )


def _modes(table: Table) -> str:
    slow, fast = (
        max(rows, key=lambda row: abs(_number(table.cell(row[0], "difference"))))[0]
        for rows in (table.rows[:SLOW], table.rows[SLOW:])
    )
    return (
        "Of the Koopman modes, slow ones first, the slow ones are the paper's (largest difference "
        f"of |λ| {table.cell(slow, 'difference')}) and the fast ones are not: mode {fast} has "
        f"{table.cell(fast, 'median')}, the paper {table.cell(fast, 'paper')}."
    )


def _contrast(table: Table) -> str:
    ours, theirs = (table.cell(cost, "iae_median") for cost in ("contrast", "lifted"))
    verdict = "better" if _number(ours) < _number(theirs) else "no better"
    return (
        "A cost that looks only along the direction in which strong oscillation differs most from "
        f"weak (contrast) does {verdict} than either: a median IAE of {ours}, and "
        f"{table.cell('contrast', 'converged')} % of its runs converge."
    )


def _number(text: str) -> float:
    return float("inf") if text == "diverged" else float(text)


SLOW = 4  # modes of |lambda| above 0.99
SENTENCES: tuple[tuple[str, Callable[[Table], str]], ...] = (
    ("robustness", _the_papers_claim),
    ("sensitivity", _the_open_constants),
    ("static_maps", _convexity),
    ("modes_spread", _modes),
    ("robustness", _contrast),
)
