"""Delay embedding against the definition, analytic spectra, and the kernel's delay line."""

import math

import numpy as np
import pytest

from koop_core.stream.arrival import Arrival
from koopman_lifter import cost
from koopman_lifter.config import LifterConfig
from koopman_lifter.delays import Delays, dominant_period, embedded_degree
from koopman_lifter.edmd import Gram
from koopman_lifter.model import build, load
from koopman_lifter.observables import Monomials

DT = 0.01
DECAY, OMEGA = 0.05, 3.0
DELAYS = Delays(1, 4, 20)


def damped(t, phase=0.0):
    """One displacement of a linear oscillator."""
    return np.exp(-DECAY * t) * np.cos(OMEGA * t + phase)


@pytest.fixture(scope="module")
def model():
    """Learned from one channel of a linear oscillator."""
    gram = Gram.empty(Monomials(2, 1))
    delays = Delays(1, 2, 30)
    for phase in np.linspace(0.0, 6.0, 7):
        gram.add_trajectory(delays.embed(damped(np.arange(4000) * DT, phase)[None]))
    return build(gram, DT, ("p",), 8, {}, delays)


def test_embedding_is_the_last_samples_of_every_channel():
    x = np.random.default_rng(0).standard_normal((3, 50))
    delays = Delays(3, 4, 5)
    embedded = delays.embed(x)
    assert embedded.shape == (12, 50 - 15)
    for k in range(15, 50):
        expected = np.concatenate([x[:, k - 5 * i] for i in range(4)])
        np.testing.assert_array_equal(embedded[:, k - 15], expected)
    assert Delays(3, 4, 20).embed(x).shape == (12, 0)
    assert delays.names(("a", "b", "c"), 0.02)[2:4] == ("c", "a(t-0.1)")


def test_one_channel_of_a_linear_oscillator_has_its_analytic_spectrum(model):
    expected = np.exp((-DECAY + 1j * OMEGA) * DT)
    actual = model.eigenvalues[np.argmin(np.abs(model.eigenvalues - expected))]
    assert abs(actual - expected) < 1e-10
    assert abs(model.eigenvalues[0] - 1.0) < 1e-10  # the constant
    assert model.kept.all()  # as many modes as there are, where more are asked for


def test_a_model_with_delays_is_saved_and_loaded(model, tmp_path):
    model.save(tmp_path / "model.npz")
    again = load(tmp_path / "model.npz")
    assert again.model_id == model.model_id
    assert again.delays == Delays(1, 2, 30)
    np.testing.assert_array_equal(again.K, model.K)
    with_names = again.observables.names(again.delays.names(again.state_names, DT))
    assert with_names == ["1", "p", "p(t-0.3)"]


def energies(model, x, arrivals=None, steps=None):
    """Return what the kernel makes of samples: r, y_out and settling."""
    lifting, params = model.lifting(), LifterConfig(dt=DT).detector_params()
    work, state, actual = cost.workspace(lifting), cost.initial(), []
    for k, value in enumerate(x):
        arrival = arrivals[k] if arrivals else Arrival.NEXT if k else Arrival.RESTART
        step = steps[k] if steps is not None else k
        r, y_out, settling, state = cost.answer(
            cost.LIFTED, lifting, params, state, int(arrival), int(step), np.array([value]), work
        )
        actual.append((r, y_out, settling))
    r, y_out, settling = np.array(actual).T
    return r, y_out, settling.astype(bool)


def test_the_kernel_lifts_what_training_embeds(model):
    x = np.random.default_rng(1).standard_normal(200)
    r, y_out, settling = energies(model, x)
    depth = model.delays.depth
    z = model.observables.lift(model.delays.embed(x[None]))
    np.testing.assert_allclose(y_out[depth - 1 :], ((model.projector @ z) ** 2).sum(axis=0))
    assert settling.tolist() == [True] * (depth - 1) + [False] * (201 - depth)
    assert np.isnan(r[: depth - 1]).all()
    assert np.isfinite(r[depth - 1 :]).all()


@pytest.mark.parametrize("lost", [1, 2])
def test_samples_that_were_lost_are_interpolated(model, lost):
    x = np.random.default_rng(2).standard_normal(300)
    kept = np.delete(np.arange(300), np.arange(100, 100 + lost))
    _, y_out, settling = energies(model, x[kept], steps=kept)
    bridged = np.interp(np.arange(300), kept, x[kept])
    np.testing.assert_allclose(y_out, energies(model, bridged)[1][kept], rtol=1e-9)
    assert not settling[model.delays.depth :].any()


def test_a_gap_or_a_silence_empties_the_delay_line(model):
    x = np.random.default_rng(2).standard_normal(300)
    depth = model.delays.depth
    kept = np.delete(np.arange(300), [100, 101, 102])
    _, y_out, settling = energies(model, x[kept], steps=kept)
    assert settling[100 : 100 + depth - 1].all()
    alone = energies(model, x[103:])[1][depth - 1 :]
    np.testing.assert_array_equal(y_out[100 + depth - 1 :], alone)
    # a silence: nothing of before is in the state after it
    arrivals = [Arrival.RESTART, *[Arrival.NEXT] * 299]
    arrivals[150] = Arrival.RESUME
    r, y_out, settling = energies(model, x, arrivals)
    assert settling[150 : 150 + depth - 1].all()
    assert np.isnan(r[150 : 150 + depth - 1]).all()
    np.testing.assert_array_equal(
        y_out[150 + depth - 1 :], energies(model, x[150:])[1][depth - 1 :]
    )


def test_a_sample_that_is_not_finite_has_no_cost_when_it_is_part_of_the_state(model):
    x = np.random.default_rng(3).standard_normal(200)
    x[120] = math.nan
    r, _, settling = energies(model, x)
    parts = {120, 120 + model.delays.every}
    assert set(np.flatnonzero(np.isnan(r) & ~settling)) == parts


def test_spacing_and_degree_are_chosen():
    t = np.arange(40000) * DT
    noise = np.random.default_rng(4).standard_normal(t.size)
    swing = (1.5 + np.sin(0.02 * t)) * np.sin(2.0 * t)
    steady = 20.0 * np.sin(9.0 * t)  # an interference is not what is looked for
    x = np.stack((swing + steady + 0.1 * noise, 3.0 * steady - swing))
    assert dominant_period([x[:, :15000], x[:, 15000:]], DT) == pytest.approx(math.pi, rel=0.1)
    for nothing in ([], [np.ones((2, 5000))], [x[:, :500]]):
        with pytest.raises(ValueError, match="too few"):
            dominant_period(nothing, DT)
    still = np.full((1, 5000), 81.2822027)  # failed before: rounding moved it, and division by zero
    with pytest.raises(ValueError, match="do not move"):
        dominant_period([still], DT)
    beside = dominant_period([np.vstack([x[:1], np.full((1, t.size), 81.2822027)])], DT)
    assert beside == dominant_period([x[:1]], DT)
    with pytest.raises(ValueError, match="nothing in the samples varies"):  # failed before, too
        dominant_period([np.arange(4080.0)[None] % 12], DT)
    assert [embedded_degree(n) for n in (1, 2, 7, 8, 14, 15, 40)] == [3, 3, 3, 2, 2, 1, 1]


@pytest.mark.parametrize("options", [(0, 1, 1), (1, 0, 1), (1, 2, 0), (1, 1, 2)])
def test_delays_that_make_no_sense_are_refused(options):
    with pytest.raises(ValueError, match=r"at least 1|no spacing"):
        Delays(*options)


def test_sums_of_a_lower_degree_are_those_of_its_monomials():
    x = np.random.default_rng(5).standard_normal((2, 500))
    high, low = Gram.empty(Monomials(2, 3)), Gram.empty(Monomials(2, 1))
    for gram in (high, low):
        gram.add_trajectory(x)
    lowered = high.of_degree(1)
    assert lowered.observables == low.observables
    assert lowered.pairs == low.pairs
    for name in ("xx", "yx", "yy"):
        np.testing.assert_allclose(getattr(lowered, name), getattr(low, name), rtol=1e-12)
