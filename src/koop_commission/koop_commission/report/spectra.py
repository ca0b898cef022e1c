"""Spectra of the channels by theta, and which of their lines are interference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koop_commission.report.contents import Contents
from koop_commission.report.drawing import BEST, FAINT, INTERFERENCE, MEASURED
from koop_core.errors import InputError
from koop_tune.excitation.channels import Line, pick_lines
from koop_tune.rig_model.dwells import DWELLS
from koop_tune.rig_model.spectra import Spectra, spectra_by_theta
from koop_view.report.document import Cell, Column, Figure, Mark, Panel, Section, Series, Table

FINE = 200  # bins that are kept as they are
COARSER = 1.02  # ratio of neighbouring frequencies above
HANN = 1.5  # bins over which the window spreads the power of a line
NEAR = 2  # bins about a line
COLUMNS = (
    Column("channel", "channel"),
    Column("frequency", "frequency [Hz]", ".3g"),
    Column("kind", "kind", words=True),
    Column("least", "least amplitude", ".3g"),
    Column("most", "largest amplitude", ".3g"),
)
INTRO = (
    "Each channel while theta was held: over all values, at the strongest and at the weakest "
    "motion. A narrow line that theta does not change is marked as interference."
)


@dataclass(frozen=True)
class Peak:
    """A narrow line of a channel.

    Attributes
    ----------
    line : Line
        Peak of the spectrum averaged over theta, or of the quietest one.
    moved : bool
        Whether theta changes it; a line that it does not change is interference.
    least, most : float
        Range of its amplitude over theta.
    """

    line: Line
    moved: bool
    least: float
    most: float

    @property
    def kind(self) -> str:
        """Oscillation or interference."""
        return "oscillation" if self.moved else "interference"


def make_spectra(c: Contents) -> Section:
    """Return the spectra of the channels, with their lines marked."""
    title, name = "Spectra", "spectra"
    if isinstance(c.loaded, str):
        return Section(name, title, f"None: {c.loaded}.")
    try:
        windows = c.excitation.windows
        length = windows.length if windows else DWELLS.window
        spectra = spectra_by_theta(c.loaded, c.rig.scale, c.rig.dt, length)
    except InputError as error:
        return Section(name, title, f"None: {error}.")
    panels = tuple(_draw(c, spectra, i) for i in range(len(c.rig.names)))
    rows: list[tuple[Cell, ...]] = [
        (channel, peak.line.frequency, peak.kind, peak.least, peak.most)
        for i, channel in enumerate(c.rig.names)
        for peak in find_peaks(spectra, i)
    ]
    table = Table(name, "Narrow lines, over all values of theta", COLUMNS, rows)
    figure = Figure(
        "spectra-figure", "Spectral density of each channel", panels, columns=min(len(panels), 2)
    )
    return Section(name, title, INTRO, [table], [figure])


def _draw(c: Contents, spectra: Spectra, channel: int) -> Panel:
    total = spectra.power.sum(axis=(1, 2))
    loud, quiet = int(np.argmax(total)), int(np.argmin(total))
    theta, density = c.rig.scale.theta(spectra.u), spectra.density[:, channel]
    starts = group(spectra.frequency)
    x = spectra.frequency[starts].tolist()

    def thin(values: NDArray[np.float64], extreme: np.ufunc = np.maximum) -> list[float]:
        return list(map(float, extreme.reduceat(values, starts)))

    low, high = density.min(axis=0), density.max(axis=0)
    series = (
        Series("all values of theta", x, thin(low, np.minimum), "band", thin(high), FAINT),
        Series(f"theta {theta[loud]:.3g}", x, thin(density[loud]), color=MEASURED),
        Series(f"theta {theta[quiet]:.3g}", x, thin(density[quiet]), color=BEST),
    )
    marks = tuple(
        Mark(hertz := peak.line.frequency, f"{peak.kind} {hertz:.3g} Hz",
             color=MEASURED if peak.moved else INTERFERENCE)
        for peak in sorted(find_peaks(spectra, channel), key=lambda peak: peak.line.frequency)
    )  # fmt: skip
    title = c.rig.names[channel]
    return Panel("frequency [Hz]", "density [1/Hz]", series, title, True, True, marks=marks)


def find_peaks(spectra: Spectra, channel: int) -> list[Peak]:
    """Return the narrow lines of a channel, the strongest first.

    They stand out on average, or where the channel is quietest: there the oscillation hides no
    interference.
    """
    frequency = spectra.frequency
    power = spectra.density[:, channel] * HANN / spectra.seconds  # of a sine
    lines: list[Peak] = []
    taken: list[int] = []
    for spectrum in (power.mean(axis=0), power[int(np.argmin(power.sum(axis=1)))]):
        # pick_lines() leaves out the first bin
        for line in pick_lines(np.r_[0.0, frequency], np.r_[0.0, spectrum]):
            at = int(np.argmin(np.abs(frequency - line.frequency)))
            if any(abs(at - other) <= NEAR for other in taken):
                continue
            taken.append(at)
            about = slice(max(at - NEAR, 0), at + NEAR + 1)
            amplitude = np.sqrt(2.0 * power[:, about].sum(axis=1) / HANN)
            moved = bool(spectra.sure[channel, at])  # beside it is what it stands out from
            lines.append(Peak(line, moved, float(amplitude.min()), float(amplitude.max())))
    return sorted(lines, key=lambda peak: -peak.most)


def group(frequency: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the first bin of each group that is drawn as one point."""
    starts = list(range(min(FINE, frequency.size)))
    following = starts[-1] + 1
    while following < frequency.size:
        starts.append(following)
        coarser = int(np.searchsorted(frequency, frequency[following] * COARSER))
        following = max(following + 1, coarser)
    return np.array(starts, np.int64)
