"""A Koopman model from one or many bags, in memory that does not depend on their size."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.reader import BagReader
from koop_core.errors import InputError
from koop_identify.model.windows import cut_windows, period_of, training_windows
from koop_identify.recording.loaded import Loaded, load_recording
from koop_identify.recording.samples import batches, sha256, state_names
from koop_identify.recording.segmentation import BagReading, find_segmentation
from koop_identify.recording.segments import Segment, Segmentation, Segmenter
from koopman_lifter.contrast import can_split, moments, with_contrast
from koopman_lifter.delays import Delays, embedded_degree, spacing_for
from koopman_lifter.edmd import Gram, RankDeficient
from koopman_lifter.model import KoopmanModel, build
from koopman_lifter.observables import Monomials


@dataclass(frozen=True)
class BagTraining:
    """Settings of a training on bags."""

    reading: BagReading
    """How a bag becomes states."""
    degree: int | None = None
    """Largest degree of the monomials; None: 3, or less where delays would make that too many."""
    modes: int = 8
    """Number N of modes to keep."""
    contrast: bool = False
    """Whether the cost is the contrast of strong and weak oscillation (koopman_lifter.contrast) in
    place of the energy of the dominant modes."""
    period: float | None = None
    """Period of the oscillation to contrast [s]; None: of the one whose power varies most."""
    delays: int = 1
    """Samples of every channel that make up the state."""
    spacing: float | None = None
    """Time between two of them [s]; None: so that they span an eighth of the dominant period."""

    def __post_init__(self) -> None:
        if self.degree is not None and not 1 <= self.degree <= 8:
            raise InputError(f"degree = {self.degree}: must be 1 to 8")
        if self.delays < 1:
            raise InputError(f"{self.delays} delays: at least 1, the newest sample")

    def degree_for(self, delays: Delays) -> int:
        """Return the largest degree of the monomials."""
        return embedded_degree(delays.n) if self.degree is None else self.degree


def train_from_bags(paths: Sequence[Path], training: BagTraining) -> KoopmanModel:
    """Learn a model in one pass over the bags.

    Raises
    ------
    koop_bag.errors.BagError
        If a bag cannot be read or lacks the topic or a field.
    koop_core.errors.InputError
        If the bags do not fit together or cannot determine the model.
    """
    measured = training.reading.measured
    gram: Gram | None = None
    delays = Delays(1)
    bags: list[dict[str, Any]] = []
    recordings: list[Loaded] = []
    for path in paths:
        with BagReader(path) as bag:
            segmentation, n = find_segmentation(bag, training.reading)
            if gram is None:  # what the first bag says holds for all of them
                training = replace(training, reading=replace(training.reading, dt=segmentation.dt))
                delays = _find_delays(bag, training, segmentation, n)
                gram = Gram.empty(Monomials(delays.n, training.degree_for(delays)))
            if n != delays.channels:
                raise InputError(
                    f"{path}: {n} numbers in {measured}, other bags have {delays.channels}"
                )
            before = gram.pairs
            segmenter = Segmenter(segmentation)
            timed = segmentation.timed(batches(bag, measured))
            segments = (segment for batch in timed for segment in segmenter.split(batch))
            for states in join_parts(segments, delays.depth):
                gram.add_trajectory(delays.embed(states))
            if training.contrast:
                recordings.append(load_recording(bag, training.reading, segmentation))
                theta = recordings[-1].theta
                if theta is not None and theta.ndim > 1:
                    raise InputError("a contrast is learned over one knob: name one of the fields")
        origin = {"name": path.name, "sha256": sha256(path), "pairs": gram.pairs - before}
        bags.append({**origin, **segmenter.described()})
    assert gram is not None
    dt = training.reading.known_dt
    dropped = sum(bag["not_finite"] for bag in bags)
    if not gram.pairs and dropped:
        raise InputError(f"no pair of states: {dropped} samples of {measured} are not finite")
    provenance: dict[str, Any] = {
        "source": "bags",
        "measured": str(measured),
        "degree": gram.observables.degree,
        "bags": bags,
    }
    if delays.count > 1:
        provenance |= {"delays": delays.count, "spacing": delays.every * dt}
    names = state_names(measured, delays.channels)
    model = build_from(gram, training, names, provenance, delays)
    if not training.contrast:
        return model
    loaded = Loaded.joined(recordings)
    return learn_contrast(model, loaded, training.period or period_of(loaded, dt))


def load_bags(paths: Sequence[Path], reading: BagReading) -> tuple[Loaded, BagReading]:
    """Hold recordings in memory, theta included; the reading is returned with the dt of all.

    Raises
    ------
    koop_bag.errors.BagError
        If a bag cannot be read or lacks the topic or a field.
    koop_core.errors.InputError
        If the bags do not fit together.
    """
    parts = []
    for path in paths:
        with BagReader(path) as bag:
            segmentation, _ = find_segmentation(bag, reading)
            reading = replace(reading, dt=segmentation.dt)  # of all bags
            parts.append(load_recording(bag, reading, segmentation))
    if len({part.x.shape[0] for part in parts}) > 1:
        raise InputError("the bags hold different numbers of channels")
    return Loaded.joined(parts), reading


def build_from(
    gram: Gram,
    training: BagTraining,
    names: tuple[str, ...],
    provenance: dict[str, Any],
    delays: Delays,
) -> KoopmanModel:
    """Return the model of the sums; of a lower degree where none was asked for and data need it.

    Products of samples that follow each other closely hardly differ. The provenance then says which
    degree was given up.
    """
    degree = gram.observables.degree
    try:
        return build(gram, training.reading.known_dt, names, training.modes, provenance, delays)
    except RankDeficient:
        if training.degree is not None or delays.count == 1 or degree == 1:
            raise
        lower = {"degree": degree - 1, "rank_deficient_at_degree": degree}
        lowered = gram.of_degree(degree - 1)
        return build_from(lowered, training, names, provenance | lower, delays)


def learn_contrast(model: KoopmanModel, loaded: Loaded, period: float) -> KoopmanModel:
    """Return the model with the cost ``contrast``, learned from the windows of a recording.

    ``period`` is the oscillation's [s].

    Raises
    ------
    koop_core.errors.InputError
        If the recording has too few windows, or a channel never moves.
    """
    starts, length = training_windows(loaded, model.delays, model.dt, period)
    covariances, means = moments(loaded.x, starts, length, model.delays)
    theta = None
    if loaded.theta is not None:
        theta = cut_windows(loaded.theta, starts, length).mean(axis=1)
    by_theta = can_split(theta)
    provenance = {
        **model.provenance,
        "variant": "contrast",
        "windows": int(starts.size),
        "window": float(f"{length * model.dt:.4g}"),
        "strong_and_weak_by": "theta" if by_theta else "amplitude",
    }
    model = with_contrast(model, covariances, means, theta if by_theta else None)
    return replace(model, provenance=provenance)


def _find_delays(
    bag: BagReader, training: BagTraining, segmentation: Segmentation, n: int
) -> Delays:
    """Return the delays, their spacing from the recording where none was given."""
    if training.delays == 1:
        return Delays(n)
    dt, spacing = segmentation.dt, training.spacing
    if spacing is None:
        loaded = load_recording(bag, training.reading, segmentation)
        spacing = spacing_for(period_of(loaded, dt), training.delays)
    return Delays.spaced(n, training.delays, spacing, dt)


def join_parts(segments: Iterator[Segment], overlap: int) -> Iterator[NDArray[np.float64]]:
    """Yield the states of segments; a later part begins with up to `overlap` states more.

    They are the end of the part before.
    """
    tail: NDArray[np.float64] | None = None
    for states, begins in segments:
        if not begins and tail is not None:
            states = np.hstack((tail, states))
        tail = states[:, -overlap:].copy()
        yield states
