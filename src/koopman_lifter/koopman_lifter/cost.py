"""The cost r_k: instantaneous energy of the measured state, then an amplitude detector.

    raw:     y_out = ||x'||_2 / sqrt(n)         (n = 2 in the paper, section 3.4)
    lifted:  y_out = ||V_dom^+ g(X)||_2^2       (X = x', or the last samples of it)

    y_hp,k = a_hp y_hp,k-1 + (1 - a_hp) (y_out,k - y_out,k-1),   a_hp = exp(-omega_h dt)
    y_lp,k = a_lp y_lp,k-1 + (1 - a_lp) y_hp,k^2,                a_lp = exp(-omega_l dt)
    r_k    = max(y_lp,k, 0)                     (after Wang and Krstic 2000)

What does not oscillate is not seen: of two channels that circle, equally large, the raw cost is 0.

The detector starts from the first measurement, not from zero: the first difference is 0. A detector
that joins a run under way would climb from 0, which looks like a cost that gets worse. So it has no
r (NaN) until both filters have settled, and then takes for y_lp the mean over the n samples that it
has had, with the filter's own weights: y_lp / (1 - a_lp^n).

Where the model's state is the last samples of the measurement, a delay line holds them. It is reset
at a start, a join, a silence; until it is full there is no cost (``settling``). One or two lost
samples are interpolated; after more it is reset: a filter over the delays may cancel signals a
thousand times its own output, and what is not of one segment comes out as a spike.

Functions that take arrays are inlined before compilation: each call would count references to them,
which costs as much as the arithmetic. So are those that every sample passes: the whole loop is 8 %
faster for it.
"""

from __future__ import annotations

import math
import sys
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import njit
from koop_core.named_tuple import replace
from koop_core.stream.arrival import Arrival
from koopman_lifter.observables import Monomials, lift_into
from koopman_lifter.settings import COST

RAW = 0
LIFTED = 1


class Lifting(NamedTuple):
    """Arrays that take a measured state to its dominant modal coordinates."""

    parent: NDArray[np.int64]
    factor: NDArray[np.int64]
    """Shape (p,): recursion of the monomials, see :class:`koopman_lifter.observables.Monomials`."""
    projector: NDArray[np.float64]
    """Shape (N, p): W with ||W z||_2 = ||V_dom^+ z||_2, see
    :func:`koopman_lifter.modes.projector`."""
    channels: int
    n: int
    every: int
    """Layout of the state, see :class:`koopman_lifter.delays.Delays`."""


class Workspace(NamedTuple):
    """Arrays that the kernel writes to: scratch, and the delay line."""

    z: NDArray[np.float64]
    """Shape (p,): scratch; receives g(X_k)."""
    embedded: NDArray[np.float64]
    """Shape (n,): X_k, newest sample first."""
    ring: NDArray[np.float64]
    """Shape (depth, channels): the last samples."""
    cursor: NDArray[np.int64]
    """Shape (3,): row of the newest sample, samples held, step of the newest."""

    @property
    def filling(self) -> int:
        """Samples until there is an embedded state."""
        return self.ring.shape[0] - int(self.cursor[1]) if self.ring.shape[0] > 1 else 0


def workspace(lifting: Lifting) -> Workspace:
    """Return what a run needs, with an empty delay line."""
    depth = (lifting.n // lifting.channels - 1) * lifting.every + 1
    return Workspace(
        np.empty(lifting.parent.shape[0]),
        np.empty(lifting.n),
        np.empty((depth, lifting.channels)),
        np.zeros(3, dtype=np.int64),
    )


def no_lifting() -> Lifting:
    """Return a placeholder for the raw cost, which needs no model."""
    observables = Monomials(2, 1)
    return Lifting(observables.parent, observables.factor, np.zeros((1, observables.p)), 2, 2, 1)


class DetectorParams(NamedTuple):
    """Scalars of the amplitude detector."""

    alpha_hp: float
    alpha_lp: float
    """Filter coefficients exp(-omega dt) [-]."""
    y_max: float
    """Largest y_out that is believed; finite."""
    settling: int
    """Samples that both filters need to settle."""
    settled: float
    """Share of y_lp that these samples have: 1 - alpha_lp^settling."""


class DetectorState(NamedTuple):
    """State of the amplitude detector."""

    y_previous: float
    y_hp: float
    y_lp: float
    """Last energy, high-pass and low-pass filter."""
    primed: bool
    """False if the next sample follows on none."""
    settling: int
    """Samples until the filters have settled and there is a cost."""


def detector_params(
    omega_h: float, omega_l: float, dt: float, y_max: float = sys.float_info.max
) -> DetectorParams:
    """Return the scalars for corner frequencies [rad/s], a sampling time [s] and a limit."""
    settling = math.ceil(min(COST.settled * (1.0 / omega_h + 1.0 / omega_l) / dt, 1e15))
    alpha_lp = math.exp(-omega_l * dt)
    settled = -math.expm1(-omega_l * dt * settling)
    return DetectorParams(math.exp(-omega_h * dt), alpha_lp, y_max, settling, settled)


@njit()
def initial() -> DetectorState:
    """Return the state before the first sample of a run."""
    return DetectorState(0.0, 0.0, 0.0, False, 0)


@njit()
def joining(p: DetectorParams) -> DetectorState:
    """Return the state before the first sample of a run that is under way.

    Also used after a switch to another cost or model: its energies are another quantity.
    """
    return DetectorState(0.0, 0.0, 0.0, False, p.settling)


@njit()
def resume(state: DetectorState) -> DetectorState:
    """Keep the filters over a silence, so that the next sample is not a jump."""
    return replace(state, primed=False)


@njit(inline="always")
def raw_energy(x: NDArray[np.float64]) -> float:
    """Return ||x||_2 / sqrt(n) of a state, shape (n,)."""
    total = 0.0
    for i in range(x.shape[0]):
        total += x[i] * x[i]
    return math.sqrt(total / x.shape[0])


@njit(inline="always")
def lifted_energy(lifting: Lifting, x: NDArray[np.float64], z: NDArray[np.float64]) -> float:
    """Return ||V_dom^+ g(X)||_2^2 of a state, shape (n,); ``z``, shape (p,), receives g(X)."""
    lift_into(lifting.parent, lifting.factor, x, z)
    total = 0.0
    for j in range(lifting.projector.shape[0]):
        c = 0.0
        for i in range(z.shape[0]):
            c += lifting.projector[j, i] * z[i]
        total += c * c
    return total


@njit()
def push(every: int, arrival: int, step: int, x: NDArray[np.float64], work: Workspace) -> bool:
    """Take a sample into the delay line; fill ``work.embedded`` and say whether it is complete."""
    ring, cursor = work.ring, work.cursor
    depth, channels = ring.shape
    if arrival != Arrival.NEXT:
        cursor[1] = 0
    newest, held = cursor[0], cursor[1]
    lost = step - cursor[2] - 1 if held > 0 else 0
    if lost > COST.bridged:
        lost = held = 0
    last = newest
    for i in range(1, lost + 2):
        newest = newest + 1 if newest + 1 < depth else 0
        weight = i / (lost + 1)
        for j in range(channels):
            if i > lost:
                ring[newest, j] = x[j]
            else:
                ring[newest, j] = (1.0 - weight) * ring[last, j] + weight * x[j]
    held = min(held + lost + 1, depth)
    cursor[0], cursor[1], cursor[2] = newest, held, step
    if held < depth:
        return False
    row = newest
    for i in range(work.embedded.shape[0] // channels):
        for j in range(channels):
            work.embedded[i * channels + j] = ring[row, j]
        row -= every
        if row < 0:
            row += depth
    return True


@njit(inline="always")
def energy(
    source: int,
    lifting: Lifting,
    arrival: int,
    step: int,
    x: NDArray[np.float64],
    work: Workspace,
) -> tuple[float, bool]:
    """Return y_out of a state for ``source`` RAW or LIFTED, and whether the delay line fills.

    While it does, y_out is NaN; see :func:`answer` for the parameters.
    """
    if source != LIFTED:
        return raw_energy(x), False
    if lifting.n == lifting.channels:
        return lifted_energy(lifting, x, work.z), False
    if push(lifting.every, arrival, step, x, work):
        return lifted_energy(lifting, work.embedded, work.z), False
    return math.nan, True


@njit()
def detect(p: DetectorParams, state: DetectorState, y_out: float) -> tuple[float, DetectorState]:
    """Return r and the detector after one sample; y_out must be finite."""
    if not state.primed:
        return max(state.y_lp, 0.0), replace(state, y_previous=y_out, primed=True)
    y_hp = p.alpha_hp * state.y_hp + (1.0 - p.alpha_hp) * (y_out - state.y_previous)
    y_lp = p.alpha_lp * state.y_lp + (1.0 - p.alpha_lp) * (y_hp * y_hp)
    return max(y_lp, 0.0), DetectorState(y_out, y_hp, y_lp, True, state.settling)


@njit(inline="always")
def take(p: DetectorParams, state: DetectorState, y_out: float) -> tuple[float, DetectorState]:
    """Process an energy that may be unusable: above y_max, or r is not finite.

    It has no r (NaN) and leaves the filters as they were; the next usable one is not a jump.
    """
    if not y_out <= p.y_max:  # nor if it is NaN
        return math.nan, resume(state)
    r, after = detect(p, state, y_out)
    if math.isfinite(r):
        return r, after
    return math.nan, resume(state)  # an infinite low-pass filter would stay so for ever


@njit()
def settle(p: DetectorParams, before: DetectorState, after: DetectorState) -> DetectorState:
    """Count a sample of a detector that settles; with the last one, y_lp becomes a mean."""
    if not (before.primed and after.primed):  # no sample of the filters
        return after
    settling = after.settling - 1
    y_lp = after.y_lp / p.settled if settling == 0 else after.y_lp
    return replace(after, y_lp=y_lp, settling=settling)


@njit(inline="always")
def follow(
    p: DetectorParams, state: DetectorState, arrival: int, y_out: float
) -> tuple[float, DetectorState]:
    """Answer one energy, whatever it is and whatever came before it.

    See :func:`answer`; r is NaN where the energy is unusable and while the detector settles.
    """
    if arrival == Arrival.NEXT and state.settling == 0:  # apart: the loop is 5 % faster for it
        return take(p, state, y_out)
    if arrival == Arrival.RESTART:
        state = initial()
    elif arrival == Arrival.JOIN:
        state = joining(p)
    elif arrival == Arrival.RESUME:
        state = resume(state)
    r, after = take(p, state, y_out)
    if state.settling > 0:
        after = settle(p, state, after)
        r = max(after.y_lp, 0.0) if after.settling == 0 else math.nan
    return r, after


@njit(inline="always")
def answer(
    source: int,
    lifting: Lifting,
    p: DetectorParams,
    state: DetectorState,
    arrival: int,
    step: int,
    x: NDArray[np.float64],
    work: Workspace,
) -> tuple[float, float, bool, DetectorState]:
    """Answer one measured state: what the lifter does with a message.

    Node, offline loop, study and replay call this. From Python, ``arrival`` must be a plain int:
    numba takes 15 us to recognise an enum.

    Parameters
    ----------
    source : int
        RAW or LIFTED.
    lifting : Lifting
        Arrays of the model.
    p : DetectorParams
        Filter coefficients and limit.
    state : DetectorState
        Detector after the previous message.
    arrival : int
        What the message is to the ones before: a
        :class:`koop_core.stream.arrival.Arrival` up to JOIN.
    step : int
        Step index k: what is missing between two steps was lost.
    x : ndarray, shape (channels,)
        Measured state x'_k; NaN where there is none, as for a message of another size.
    work : Workspace
        Buffers of this run.

    Returns
    -------
    r, y_out : float
        Cost and instantaneous energy; r is NaN where y_out is unusable, and while it settles.
    settling : bool
        Whether there is no cost yet: the detector has joined a run and has not settled, or the
        delay line is not full.
    state : DetectorState
        Detector after this message.
    """
    y_out, filling = energy(source, lifting, arrival, step, x, work)
    r, state = follow(p, state, arrival, y_out)
    return r, y_out, filling or state.settling > 0, state
