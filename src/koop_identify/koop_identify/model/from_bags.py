"""A Koopman model from one or many bags, in memory that does not depend on their size."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.reader import BagReader
from koop_identify.model.merit import cut_windows
from koop_identify.model.windows import period_of, training_windows
from koop_identify.recording.counted import mean_period
from koop_identify.recording.loaded import Loaded, load_states, theta_of
from koop_identify.recording.recorded_parameters import recorded_values
from koop_identify.recording.samples import STEP, Batch, StateSpec, batches, sha256, state_names
from koop_identify.recording.segments import Segment, Segmentation, Segmenter, counted_spacing
from koopman_lifter.contrast import can_tell, moments, with_contrast
from koopman_lifter.delays import Delays, embedded_degree, spacing_for
from koopman_lifter.edmd import STRETCHES, Gram, RankDeficient
from koopman_lifter.fit import Fit
from koopman_lifter.model import KoopmanModel, build
from koopman_lifter.observables import Monomials
from koopman_lifter.prediction import Forecast

GAPS = 3.0  # a pause of more than so many usual periods, or Dt, is a gap


@dataclass(frozen=True)
class BagTraining:
    """What to learn from bags.

    Attributes
    ----------
    state : StateSpec
        Fields that are the state.
    dt : float or None
        Time between two states [s]; None: the recorded loop's.
    way : str
        One of koop_identify.recording.segments.WAYS, or `auto`: by steps where the messages
        have them and are one dt apart, else linear.
    gap : float or None
        Longest pause that is bridged [s]; None: three times the usual period, at least three dt.
        Without stamps, the time in which no sample was taken, however late those before came.
    held_out : float
        Share of the data that is not learned from, 0 to 0.5.
    horizons : tuple of int
        Steps ahead of which the error on the held-out data is found.
    degree : int or None
        Largest degree of the monomials; None: 3, or less where delays would make that too many.
    modes : int
        Number N of modes to keep.
    names : tuple of str
        Names of the states; empty: from the fields.
    contrast : bool
        Whether the cost is the contrast of strong and weak oscillation (koopman_lifter.contrast)
        in place of the energy of the dominant modes.
    period : float or None
        Of the oscillation that the contrast is of [s]; None: of what comes and goes.
    delays : int
        Samples of every channel that make up the state.
    spacing : float or None
        Time between two of them [s]; None: so that they span an eighth of the dominant period.
    theta : str or None
        Field that is theta, such as /knob:data; None: /theta:theta if the bag has it.
    fit : Fit
        From the sums over the data to the modes.
    """

    state: StateSpec
    dt: float | None = None
    way: str = "auto"
    gap: float | None = None
    held_out: float = 0.2
    horizons: tuple[int, ...] = (1, 10, 50, 200)
    degree: int | None = None
    modes: int = 8
    names: tuple[str, ...] = ()
    contrast: bool = False
    period: float | None = None
    delays: int = 1
    spacing: float | None = None
    theta: str | None = None
    fit: Fit = field(default_factory=Fit)

    def __post_init__(self) -> None:
        if not 0.0 <= self.held_out <= 0.5:
            raise ValueError(f"held-out share {self.held_out:g}: must be 0 to 0.5")
        if not self.horizons or min(self.horizons) < 1:
            raise ValueError("horizons are steps ahead, each at least 1")
        if self.degree is not None and not 1 <= self.degree <= 8:
            raise ValueError(f"degree = {self.degree}: must be 1 to 8")
        if self.delays < 1:
            raise ValueError(f"{self.delays} delays: at least 1, the newest sample")
        if self.spacing is not None and self.delays == 1:
            raise ValueError("--spacing is that of --delays: give both")
        for name, value in (
            ("dt", self.dt),
            ("gap", self.gap),
            ("period", self.period),
            ("spacing", self.spacing),
        ):
            if value is not None and not 0.0 < value < 1e6:
                raise ValueError(f"{name} = {value:g} s: must be positive")

    def degree_for(self, delays: Delays) -> int:
        """Return the largest degree of the monomials."""
        return embedded_degree(delays.n) if self.degree is None else self.degree


def train_from_bags(paths: Sequence[Path], training: BagTraining) -> KoopmanModel:
    """Learn a model; one pass over the bags for it, one more for its error on held-out data.

    Raises
    ------
    koop_bag.errors.BagError
        If a bag cannot be read or lacks the topic or a field.
    ValueError
        If the bags do not fit together or cannot determine the model.
    """
    gram: Gram | None = None
    segmentations: list[Segmentation] = []
    described: list[dict[str, Any]] = []
    loaded: list[Loaded] = []
    for path in paths:
        with BagReader(path) as bag:
            segmentation, n = find_segmentation(bag, path, training)
            if gram is None:
                training = replace(training, dt=segmentation.dt)  # of all bags
                delays = _delays(bag, training, segmentation, n)
                degree = training.degree_for(delays)
                gram = Gram.empty(Monomials(delays.n, degree))
                names = training.names or state_names(training.state, n)
                if len(names) != n:
                    raise ValueError(f"{len(names)} state names for {n} states")
            if n != delays.channels:
                raise ValueError(f"{path}: {n} numbers in {training.state}, other bags have "
                                 f"{delays.channels}")  # fmt: skip
            count = bag.topic(training.state.topic).count
            segmenter = Segmenter(segmentation, count)
            before, stretch = gram.pairs, max(1, count // STRETCHES)
            segments = _segments(bag, training.state, segmenter)
            for segment, _ in joined(segments, delays.depth):
                if not segment.held_out:
                    gram.add_trajectory(delays.embed(segment.states), stretch)
            if training.contrast:
                theta = theta_of(bag, training.theta)
                loaded.append(load_states(bag, training.state, segmentation, theta))
            segmentations.append(segmentation)
            described.append(
                {
                    "name": path.name,
                    "sha256": sha256(path),
                    "pairs": gram.pairs - before,
                    **segmenter.described(),
                }
            )
    assert gram is not None
    assert training.dt is not None
    dropped = sum(bag["not_finite"] for bag in described)
    if not gram.pairs and dropped:
        raise ValueError(f"no pair of states: {dropped} samples of {training.state} are not finite")
    provenance: dict[str, Any] = {
        "source": "bags",
        "state": str(training.state),
        "held_out": training.held_out,
        "degree": degree,
        "bags": described,
    }
    if delays.count > 1:
        provenance |= {"delays": delays.count, "spacing": delays.every * training.dt}
    model = built(gram, training, names, provenance, delays)
    if training.contrast:
        whole = Loaded.joined(loaded)
        period = training.period or period_of(whole, training.dt)
        model = contrasted(model, whole, period)
    if not training.held_out:
        return model
    forecast = Forecast(model, training.horizons)
    for path, segmentation in zip(paths, segmentations, strict=True):
        with BagReader(path) as bag:
            segmenter = Segmenter(segmentation, bag.topic(training.state.topic).count)
            segments = _segments(bag, training.state, segmenter)
            overlap = max(training.horizons) + delays.depth - 1
            for segment, known in joined(segments, overlap):
                if segment.held_out:
                    forecast.add(segment.states, known)
    return replace(model, provenance={**model.provenance, "forecast": forecast.result()})


def load_bags(paths: Sequence[Path], training: BagTraining) -> tuple[Loaded, BagTraining]:
    """Hold recordings in memory, theta included; the training is returned with the dt of all.

    Raises
    ------
    koop_bag.errors.BagError
        If a bag cannot be read or lacks the topic or a field.
    ValueError
        If the bags do not fit together.
    """
    parts = []
    for path in paths:
        with BagReader(path) as bag:
            segmentation, _ = find_segmentation(bag, path, training)
            training = replace(training, dt=segmentation.dt)  # of all bags
            theta = theta_of(bag, training.theta)
            parts.append(load_states(bag, training.state, segmentation, theta))
    if len({part.x.shape[0] for part in parts}) > 1:
        raise ValueError("the bags hold different numbers of channels")
    return Loaded.joined(parts), training


def built(
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
    assert training.dt is not None
    degree = gram.observables.degree
    try:
        return build(gram, training.dt, names, training.modes, provenance, delays, training.fit)
    except RankDeficient:
        if training.degree is not None or delays.count == 1 or degree == 1:
            raise
        lower = {"degree": degree - 1, "rank_deficient_at_degree": degree}
        return built(gram.of_degree(degree - 1), training, names, provenance | lower, delays)


def contrasted(model: KoopmanModel, loaded: Loaded, period: float) -> KoopmanModel:
    """Return the model with the cost ``contrast``, learned from the windows of a recording.

    ``period`` is that of the oscillation [s].

    Raises
    ------
    ValueError
        If the recording has too few windows, or a channel never moves.
    """
    starts, length = training_windows(loaded, model.delays, model.dt, period)
    covariances, means = moments(loaded.x, starts, length, model.delays)
    theta = None
    if loaded.theta is not None:
        theta = cut_windows(loaded.theta, starts, length).mean(axis=1)
    told = can_tell(theta)
    provenance = {
        **model.provenance,
        "variant": "contrast",
        "windows": int(starts.size),
        "window": float(f"{length * model.dt:.4g}"),
        "strong_and_weak_by": "theta" if told else "amplitude",
    }
    model = with_contrast(model, covariances, means, theta if told else None)
    return replace(model, provenance=provenance)


def _delays(bag: BagReader, training: BagTraining, segmentation: Segmentation, n: int) -> Delays:
    """Return the delays, their spacing from the recording where none was given."""
    if training.delays == 1:
        return Delays(n)
    dt, spacing = segmentation.dt, training.spacing
    if spacing is None:
        period = period_of(load_states(bag, training.state, segmentation, None), dt)
        spacing = spacing_for(period, training.delays)
    return Delays.spaced(n, training.delays, spacing, dt)


def joined(segments: Iterator[Segment], overlap: int) -> Iterator[tuple[Segment, int]]:
    """Repeat the end of a part of a segment at the beginning of the next part.

    Yields
    ------
    segment : Segment
        With up to `overlap` states more.
    known : int
        How many of its states were in the part before.
    """
    tail: NDArray[np.float64] | None = None
    for part in segments:
        known = 0
        states = part.states
        if not part.begins and tail is not None:
            known = tail.shape[1]
            states = np.hstack((tail, states))
        tail = states[:, -overlap:].copy()
        yield part._replace(states=states), known


def _segments(bag: BagReader, state: StateSpec, segmenter: Segmenter) -> Iterator[Segment]:
    for batch in segmenter.segmentation.timed(batches(bag, state)):
        yield from segmenter.split(batch)


def find_segmentation(
    bag: BagReader, path: Path, training: BagTraining
) -> tuple[Segmentation, int]:
    """Return how to split a bag into segments, as far as possible from what it says itself, and n.

    Raises
    ------
    ValueError
        If the topic is empty, nothing says what dt is, or there is no time to go by.
    """
    first = next(batches(bag, training.state), None)
    if first is None or first.time.size < 2:
        raise ValueError(f"{path}: fewer than two messages on {training.state.topic}")
    period = _period(first)
    recorded = recorded_values(bag, path, training.state.topic.rpartition("/")[0] or "/")
    own = recorded.get("koopman_lifter", {}).get("dt")
    dt = training.dt or own
    if dt is None:
        raise ValueError(
            f"{path}: nothing in the bag says what the time between two states is to be; "
            f"give --dt (the usual time between two messages is {period:.6g} s)"
        )
    way = training.way
    if way == "auto":
        stepped = first.step is not None and (own == dt or abs(_step_time(first) / dt - 1.0) < 0.01)
        way = "steps" if stepped else "linear"
    if way == "steps" and first.step is None:
        raise ValueError(f"{path}: messages on {training.state.topic} have no field '{STEP}'")
    counted = way in ("linear", "zoh") and not first.stamped
    if counted and period <= 0.0:
        raise ValueError(
            f"{path}: messages on {training.state.topic} have no stamp and were all received at "
            "one time: if they are one dt apart, give --resample none"
        )
    usual = counted_spacing(period, dt) if counted else period
    gap = training.gap or GAPS * max(usual, dt)
    segmentation = Segmentation(
        way, float(dt), float(gap), training.held_out, period if counted else 0.0
    )
    return segmentation, first.x.shape[1]


def _period(batch: Batch) -> float:
    """Return the usual time between two samples [s]."""
    if not batch.stamped:  # they may have come in batches
        return mean_period(batch.time) * 1e-9
    return float(np.median(np.diff(batch.time))) * 1e-9


def _step_time(batch: Batch) -> float:
    """Return the usual time between two steps [s]; NaN if they do not grow."""
    assert batch.step is not None
    steps, apart = np.diff(batch.step), np.diff(batch.time)
    return float(np.median(apart[steps == 1])) * 1e-9 if (steps == 1).any() else float("nan")
