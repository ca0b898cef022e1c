"""One figure of the report as a PNG, for a README."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # a file is written: no display is needed or looked for
from matplotlib import pyplot as plt

from koop_view.report.document import Figure

# Of our own choice and fixed: two curves that a colour-blind reader can tell apart.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")


def draw(figure: Figure, path: Path) -> None:
    """Draw the figure's panels one below the other; curves and levels only."""
    count = len(figure.panels)
    canvas, axes = plt.subplots(
        count, 1, sharex=True, squeeze=False, figsize=(9.0, 3.2 * count), layout="constrained"
    )
    for axis, panel in zip(axes[:, 0], figure.panels, strict=True):
        for series in panel.series:
            if series.kind == "level":
                axis.plot(series.x, series.y, "--", color="0.3", linewidth=1.0, label=series.name)
            else:
                colour = COLOURS[series.color % len(COLOURS)]
                axis.plot(series.x, series.y, color=colour, linewidth=1.2, label=series.name)
        axis.set_ylabel(panel.y_label)
        axis.grid(alpha=0.3)
        axis.legend(loc="upper right", ncols=3)
    axes[-1, 0].set_xlabel(figure.panels[-1].x_label)
    # no date and no version in the file: the same study gives the same bytes
    canvas.savefig(path, dpi=110, metadata={"Software": None})
    plt.close(canvas)
