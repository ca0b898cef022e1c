"""The family of random rigs: reproducible, within its ranges, and right about its own truths."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from koop_core.config.objects import parse
from koop_core.config.parameter import ConfigError
from koop_study.family import oscillator
from koop_study.family.config import MAPS, WITH_OPTIMUM, FamilyConfig
from koop_study.family.loop import RigController, close, from_end, noise_of
from koop_study.family.rig import GRID, RandomRig, draw
from koopman_lifter.config import LifterConfig
from relay_esc.config import EscConfig

STILL = {"drift": (0.0, 0.0)}
ALL = FamilyConfig(maps=dict.fromkeys(MAPS, 1.0))


@cache
def drawn(seed: int) -> RandomRig:
    return draw(ALL, seed)


def of(maps: str, seed: int = 0, **settings: object) -> RandomRig:
    return draw(FamilyConfig(maps={maps: 1.0}, **{**STILL, **settings}), seed)  # type: ignore[arg-type]


def rms(rig: RandomRig, theta: float, seed: int, periods: float) -> float:
    """Brute force: amplitude at a resting theta, after it has settled."""
    steps = round(periods / rig.frequency / rig.params.dt)
    settling = round(25.0 * rig.slowest / rig.params.dt)
    _, amplitude = rig.record(np.full(settling + steps, theta), seed)
    return float(np.sqrt(np.mean(amplitude[settling:] ** 2)))


def same(one: RandomRig, other: RandomRig) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one.params, other.params, strict=True))


def test_the_same_seed_draws_the_same_rig_and_another_one_another() -> None:
    assert same(drawn(3), draw(ALL, 3))
    assert drawn(3).theta_initial == draw(ALL, 3).theta_initial
    assert not same(drawn(3), drawn(4))
    x, amplitude = drawn(3).record(np.full(500, drawn(3).theta_initial), 7)
    again, _ = draw(ALL, 3).record(np.full(500, drawn(3).theta_initial), 7)
    assert np.array_equal(x, again)
    assert x.shape == (500, drawn(3).channels)
    assert amplitude.shape == (500,)


def test_another_range_of_one_quantity_leaves_the_rest_of_the_rig_as_it_was() -> None:
    loud, still = of("symmetric", 5, clean=0.0), of("symmetric", 5, clean=1.0)
    assert loud.params.tone.size > 0 == still.params.tone.size
    bare = {name: np.zeros(0) for name in ("tone", "tone_amplitude", "tone_phase")}
    assert same(*(RandomRig(0, "", 1.0, 0.0, rig.params._replace(**bare)) for rig in (loud, still)))


def test_rigs_are_within_the_ranges_and_of_every_kind() -> None:
    rigs = [drawn(seed) for seed in range(60)]
    assert {rig.map for rig in rigs} == set(MAPS)
    assert {rig.params.kind for rig in rigs} == {oscillator.LIMIT_CYCLE, oscillator.NOISE_DRIVEN}
    assert {rig.objective for rig in rigs} == {"minimise", "maximise"}
    assert {rig.params.log_scale for rig in rigs} == {False, True}
    assert {rig.channels for rig in rigs} == {1, 2, 3, 4}
    for rig in rigs:
        p = rig.params
        assert 0.05 <= rig.frequency <= 50.0
        assert 20 <= round(1.0 / rig.frequency / p.dt) <= 50
        assert p.theta_min < rig.theta_initial < p.theta_max
        if p.log_scale:
            assert 1e-3 <= p.theta_min < 10.0 * p.theta_min < p.theta_max * 1.0001 <= 1e3 * 1.001
        else:
            assert 1e-3 <= p.theta_max - p.theta_min <= 1e3
        taus = [rig.relaxation(oscillator.theta_at(p, u)) * rig.frequency for u in GRID[::100]]
        assert 2.0 * 0.999 <= min(taus) <= max(taus) <= 200.0 * 1.001
        assert max(taus) <= rig.slowest * rig.frequency * 1.001


@pytest.mark.parametrize("log_scaled", [0.0, 1.0])
def test_position_and_theta_are_each_others_inverse(log_scaled: float) -> None:
    p = of("symmetric", 2, log_scaled=log_scaled).params
    for u in (0.0, 0.3, 1.0):
        assert oscillator.position(p, oscillator.theta_at(p, u)) == pytest.approx(u, abs=1e-12)
    middle = oscillator.theta_at(p, 0.5)
    mean = math.sqrt(p.theta_min * p.theta_max) if log_scaled else (p.theta_min + p.theta_max) / 2
    assert middle == pytest.approx(mean, rel=1e-9)


@pytest.mark.parametrize("noise_driven", [0.0, 1.0])
@pytest.mark.parametrize("maximised", [0.0, 1.0])
@pytest.mark.parametrize("name", ["asymmetric", "narrow", "two-valleys", "two-modes"])
def test_the_true_amplitude_is_that_of_a_long_run(
    name: str, noise_driven: float, maximised: float
) -> None:
    settings = {"noise_driven": noise_driven, "maximised": maximised, "amplitude_time": (2.0, 4.0)}
    rig = of(name, 1, **settings)
    for u in (0.1, 0.5, 0.9):
        theta = oscillator.theta_at(rig.params, u)
        # noise-driven: |z|^2 is exponential with a memory of tau / 2 <= 2 periods; the mean over
        # 5000 periods has a standard deviation of 2.8 %, its root half of that
        tolerance = 0.04 if noise_driven else 1e-6
        assert rms(rig, theta, 4, 5000.0 if noise_driven else 100.0) == pytest.approx(
            rig.amplitude(theta), rel=tolerance
        )


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("maximised", [0.0, 1.0])
def test_the_best_theta_is_the_best_of_many(name: str, maximised: float) -> None:
    settings = {"maximised": maximised, "noise_driven": 0.0, "amplitude_time": (2.0, 2.0)}
    for seed in range(4):
        rig = of(name, seed, **settings)
        thetas = [oscillator.theta_at(rig.params, u) for u in np.linspace(0.0, 1.0, 41)]
        actual = [rms(rig, theta, seed, 3.0) for theta in thetas]
        best, amplitude = rig.best()
        pick = max if rig.objective == "maximise" else min
        # a limit cycle has settled to 1e-6 after 25 time constants, from any level
        assert amplitude == pytest.approx(pick([*actual, rms(rig, best, seed, 3.0)]), rel=1e-3)
        assert rig.has_optimum == (name in WITH_OPTIMUM or name == "drowned") - (name == "drowned")
        if rig.has_optimum:
            worst = (max if pick is min else min)(actual)
            assert max(worst / amplitude, amplitude / worst) > 1.5
            u = oscillator.position(rig.params, rig.theta_initial)
            assert abs(u - oscillator.position(rig.params, best)) >= 0.249


def test_the_amplitude_goes_up_and_down_with_the_time_constant() -> None:
    rig = of("symmetric", 3, noise_driven=0.0, amplitude_time=(50.0, 50.0))
    p, (best, low) = rig.params, rig.best()
    steps = round(rig.relaxation(best) / p.dt)
    # 0.1 % beside the level, the deviation falls to 1/e within tau
    state = oscillator.RigState(1.001 * low, 0.0, 0.0, 0.0, oscillator.position(p, best))
    x, amplitude = np.empty((steps + 1, rig.channels)), np.empty(steps + 1)
    noise = np.zeros((steps + 1, 2 + rig.channels))
    oscillator.run(p, state, 0, np.full(steps + 1, best), noise, x, amplitude)
    assert amplitude[-1] / low - 1.0 == pytest.approx(1e-3 * math.exp(-1.0), rel=0.01)


def test_a_noise_driven_amplitude_has_its_memory() -> None:
    rig = of("symmetric", 3, noise_driven=1.0, amplitude_time=(5.0, 5.0))
    p, (best, _) = rig.params, rig.best()
    lag = round(rig.relaxation(best) / p.dt)
    _, amplitude = rig.record(np.full(20_000 * lag // 10, best), 1)
    square = amplitude**2 - np.mean(amplitude**2)
    # <|z|^2 |z|^2'> of a complex Ornstein-Uhlenbeck process decays as exp(-2 t / tau)
    actual = np.mean(square[lag:] * square[:-lag]) / np.mean(square**2)
    assert actual == pytest.approx(math.exp(-2.0), abs=0.05)


def test_the_interference_has_the_ratio_asked_for_and_is_common_or_lagged() -> None:
    clean = {"quiet": 1.0, "harmonic": (0.0, 0.0), "amplitude_time": (2.0, 2.0)}
    loud = {"interference": (5.0, 5.0), "clean": 0.0, "channels": (2, 2)}
    for common in (0.0, 1.0):
        rig = of("flat", 4, **clean, **loud, common=common, noise_driven=0.0)
        p = rig.params
        x, _ = rig.record(np.full(200_000, rig.theta_initial), 0)
        still, _ = of("flat", 4, **clean, **{**loud, "clean": 1.0}, noise_driven=0.0).record(
            np.full(200_000, rig.theta_initial), 0
        )
        alone = x - still
        if common:
            assert np.array_equal(p.tone_phase[:, 0], p.tone_phase[:, 1])
            assert np.allclose(alone[:, 0], alone[:, 1], atol=1e-9 * p.middle)
            # some thousand periods of each tone
            assert np.sqrt(np.mean(alone**2)) == pytest.approx(
                5.0 * p.middle / math.sqrt(2.0), rel=0.01
            )
        else:
            assert np.abs(alone[:, 0] - alone[:, 1]).max() > 0.1 * p.middle


def test_a_drifting_optimum_turns_at_the_ends() -> None:
    drifting = of("symmetric", 6, drift=(0.1, 0.1), frequency=(1.0, 1.0), amplitude_time=(2.0, 2.0))
    p = drifting.params
    assert abs(p.drift) == pytest.approx(0.1 / 3600.0)
    path = [oscillator.best_position(p, t) for t in np.linspace(0.0, 20 * 3600.0, 500)]
    assert path[0] == p.best
    assert min(path) >= 0.05 - 1e-9
    assert max(path) <= 0.95 + 1e-9
    assert np.abs(np.diff(path)).max() <= 0.1 * 20 / 499 + 1e-9
    assert np.ptp(path) > 0.85


def test_the_best_fixed_theta_of_a_drifting_optimum_is_the_best_of_many_runs() -> None:
    settings = {"noise_driven": 0.0, "amplitude_time": (2.0, 2.0), "power": (1.0, 1.0),
                "maximised": 0.0}  # fmt: skip
    rig = of(
        "symmetric", 9, drift=(1.0, 1.0), depth=(3.0, 3.0), frequency=(0.5, 0.5), log_scaled=0.0,
        **settings,
    )  # fmt: skip
    duration = 0.5 / abs(rig.params.drift)
    theta, amplitude = rig.best_fixed(duration)
    steps = round(duration / rig.params.dt)

    def run(theta: float) -> float:
        return float(np.sqrt(np.mean(rig.record(np.full(steps, theta), 0)[1] ** 2)))

    # tau is a fiftieth of the time or less: what the amplitude lags behind counts little
    assert run(theta) == pytest.approx(amplitude, rel=0.05)
    thetas = [oscillator.theta_at(rig.params, u) for u in np.linspace(0.0, 1.0, 21)]
    assert run(theta) <= 1.02 * min(run(other) for other in thetas)


def controller_of(rig: RandomRig, speed: float) -> RigController:
    """Return the raw cost and a relay that moves theta by so many ranges in the rig's own time."""
    p = rig.params
    esc = EscConfig(
        theta_min=p.theta_min, theta_max=p.theta_max, theta_initial=rig.theta_initial,
        step_size=speed * (p.theta_max - p.theta_min) * p.dt / rig.time, dwell=rig.time,
        tau_f=rig.time, objective=rig.objective,
    )  # fmt: skip
    omega_h = 40.0 * math.pi * rig.frequency
    return RigController(LifterConfig(dt=p.dt, omega_h=omega_h, omega_l=4.5 / rig.time), esc)


def test_a_theta_left_at_the_best_has_a_ratio_of_one() -> None:
    rig = of("symmetric", 2, clean=1.0, noise_driven=0.0, amplitude_time=(2.0, 4.0))
    resting = replace(rig, theta_initial=rig.best()[0])
    noise = noise_of(resting, round(20.0 * rig.time / rig.params.dt), 2)
    done = close(resting, controller_of(resting, 0.0), noise, 2)
    assert done.ratio == pytest.approx(1.0, abs=1e-12)


def at(rig: RandomRig, u: float) -> float:
    """Return the amplitude at a position over that at the best theta."""
    return rig.amplitude(oscillator.theta_at(rig.params, u)) / rig.best()[1]


MIDDLE = {"optimum": (0.5, 0.5), "maximised": 0.0}


def test_a_narrow_valley_has_its_width_its_depth_and_visible_skirts() -> None:
    rig = of("narrow", width=(0.04, 0.04), skirts=(0.1, 0.1), depth=(10.0, 10.0), **MIDDLE)
    for side in (-1.0, 1.0):
        # x = 1 at half the width, 100 at the skirts: (1 + x) / (1 + x / 100)
        assert at(rig, 0.5 + side * 0.02) == pytest.approx(math.sqrt(2.0 / 1.01))
        assert at(rig, 0.5 + side * 0.1) == pytest.approx(math.sqrt(101.0 / 2.0))
        assert at(rig, 0.5 + side * 0.5) == pytest.approx(10.0, rel=0.01)
    for seed in range(40):  # between dwell points an eighth of the range apart something shows
        rig = of("narrow", seed, depth=(5.0, 100.0), maximised=0.0)
        u = oscillator.position(rig.params, rig.best()[0])
        far = u + (0.4 if u < 0.5 else -0.4)
        near = u + (0.0625 if u < 0.5 else -0.0625)
        assert at(rig, far) / at(rig, near) > 1.15


def test_of_two_valleys_the_narrow_one_is_the_deeper() -> None:
    settings = {"width": (0.05, 0.1), "depth": (15.0, 40.0), "maximised": 0.0}
    for seed in range(40):
        rig = of("two-valleys", seed, **settings)
        p = rig.params
        levels = oscillator.levels(p, GRID, 0.0) / p.level
        valleys = 1 + np.flatnonzero((levels[1:-1] < levels[:-2]) & (levels[1:-1] <= levels[2:]))
        assert sorted(GRID[valleys]) == pytest.approx(sorted([p.best, p.best + p.apart]), abs=1e-3)
        assert at(rig, p.best + p.apart) == pytest.approx(p.shallower)
        assert p.shallower >= 2.0
        wide = [np.ptp(GRID[levels <= math.sqrt(2.0) * bottom]) for bottom in (1.0, p.shallower)]
        assert 0.05 * 0.97 <= wide[0] <= 0.1 * 1.01 < wide[1]
        ridge = levels[min(valleys) : max(valleys)].max()
        assert ridge > 1.3 * p.shallower


def test_two_modes_trade_off_and_their_sum_is_least_in_between() -> None:
    settings = {"depth": (4.0, 4.0), "noise_driven": 0.0, "clean": 1.0, "quiet": 1.0, **MIDDLE}
    rig = of("two-modes", 3, harmonic=(0.0, 0.0), amplitude_time=(2.0, 2.0), **settings)
    p = rig.params
    # by hand: slopes ln(4 sqrt 2) / 0.5, so L^2 = (32 + 1 / 32) / 2 at both ends, but for what
    # noise keeps alive of both modes
    assert at(rig, 0.0) == pytest.approx(math.sqrt(0.9982 * (16.0 + 1.0 / 64.0) + 0.0018))
    assert at(rig, 1.0) == pytest.approx(at(rig, 0.0))
    first, second = oscillator.two_modes(p, 0.5, 0.0)
    assert first == pytest.approx(second) == pytest.approx(p.level / math.sqrt(2.0))
    assert 2.0 <= p.second <= 4.0
    for u, ratio in ((0.0, 1.0), (1.0, p.second)):
        x, _ = rig.record(np.full(20_000, oscillator.theta_at(p, u)), 1)
        lines = np.abs(np.fft.rfft(x[4000:, 0] * np.hanning(16_000)))
        lines[:10] = 0.0
        strongest = np.fft.rfftfreq(16_000, p.dt)[np.argmax(lines)]
        assert strongest == pytest.approx(ratio * rig.frequency, rel=0.02)


def test_both_modes_run_at_their_own_levels() -> None:
    for noise_driven, tolerance in ((0.0, 1e-6), (1.0, 0.06)):  # 1000 periods; tau / 2 is 1
        rig = of("two-modes", 2, noise_driven=noise_driven, amplitude_time=(2.0, 2.0))
        p, u = rig.params, 0.3
        state, squares = rig.initial(1), np.zeros(2)
        steps = round(1000.0 / rig.frequency / p.dt)
        for k, noise in enumerate(rig.noise(steps, 1)):
            state = oscillator.step(p, state, k, oscillator.theta_at(p, u), *noise[:2])
            if k >= steps // 10:
                squares += state.re**2 + state.im**2, state.other_re**2 + state.other_im**2
        levels = np.sqrt(squares / (steps - steps // 10))
        assert levels == pytest.approx(oscillator.two_modes(p, u, 0.0), rel=tolerance)


@pytest.mark.parametrize("seed", range(8))
def test_the_channels_of_two_modes_show_the_true_amplitude(seed: int) -> None:
    settings = {"depth": (3.0, 8.0), "optimum": (0.25, 0.75), "channels": (1.0, 4.0)}
    rig = of("two-modes", seed, **settings)
    modes = np.array([oscillator.two_modes(rig.params, u, 0.0) for u in GRID]) ** 2
    gains = np.array([(rig.params.mix[:, i : i + 2] ** 2).sum(axis=1) for i in (0, 3)])
    motion = modes @ gains
    seen = (motion / motion.max(axis=0)).sum(axis=1)  # each channel in units of its own motion
    assert seen / modes.sum(axis=1) == pytest.approx(seen[0] / modes[0].sum())
    assert gains.std(axis=0).min() > 0.0 or gains.shape[0] == 1  # not each channel shows both alike


@pytest.mark.parametrize("log_scaled", [0.0, 1.0])
def test_theta_acts_with_a_play(log_scaled: float) -> None:
    settings = {"noise_driven": 0.0, "amplitude_time": (2.0, 2.0), "log_scaled": log_scaled}
    rig = of("symmetric", 7, play=(0.04, 0.04), **settings)
    p = rig.params
    state, path = replace(rig, theta_initial=p.theta_min).initial(0), []
    for u in (0.0, 0.01, 0.5, 0.49, 0.47, 0.3, 0.34, 0.35):
        state = oscillator.step(p, state, 0, oscillator.theta_at(p, u), 0.0, 0.0)
        path.append(state.u)
    assert path == pytest.approx([0.0, 0.0, 0.48, 0.48, 0.48, 0.32, 0.32, 0.33])
    steps = round(200.0 / rig.frequency / p.dt)
    for start, acting in ((0.1, 0.48), (0.9, 0.52)):  # rests at 0.5, come to from below, above
        u = np.r_[np.linspace(start, 0.5, steps), np.full(steps, 0.5)]
        begun = replace(rig, theta_initial=oscillator.theta_at(p, start))
        _, amplitude = begun.record(np.array([oscillator.theta_at(p, v) for v in u]), 1)
        expected = rig.amplitude(oscillator.theta_at(p, acting))
        assert amplitude[-steps // 2 :].mean() == pytest.approx(expected, rel=1e-6)
    theta, best = rig.best()  # reached from below and from above, commanded beyond it
    assert best == p.level == rig.amplitude(theta)


def test_an_oscillation_grows_slowly_near_the_optimum_and_fast_elsewhere() -> None:
    settings = {"noise_driven": 0.0, "maximised": 0.0, "amplitude_time": (30.0, 100.0),
                "quicker": (15.0, 15.0), "growth": (1.0, 1.0), "depth": (10.0, 10.0)}  # fmt: skip
    for seed in range(10):
        rig = of("symmetric", seed, **settings)
        p, (best, low) = rig.params, rig.best()
        slow = rig.relaxation(best)
        assert 30.0 * 0.999 <= slow * rig.frequency <= 100.0 * 1.001
        assert rig.slowest == pytest.approx(slow, rel=1e-4)
        ends = max(rig.amplitude(p.theta_min), rig.amplitude(p.theta_max))
        assert ends == pytest.approx(10.0 * low)  # tau as 1 / L, at least 2 periods
        fast = min(rig.relaxation(p.theta_min), rig.relaxation(p.theta_max))
        assert fast == pytest.approx(max(slow / 10.0, 2.0 / rig.frequency))
        # far below its level |z| grows e-fold in 2 tau
        steps = round(2.0 * slow / p.dt)
        state = oscillator.RigState(1e-4 * low, 0.0, 0.0, 0.0, oscillator.position(p, best))
        for k in range(steps):
            state = oscillator.step(p, state, k, best, 0.0, 0.0)
        grown = math.sqrt(oscillator.energy(state)) / (1e-4 * low)
        assert grown == pytest.approx(math.exp(steps * p.dt / (2.0 * slow)), rel=1e-3)


def test_an_interference_may_be_slower_and_stronger_than_the_oscillation() -> None:
    slow = (0.05, 0.3)
    for seed in range(10):
        settings = {"lower_tones": slow, "upper_tones": slow, "interference": (3.0, 10.0)}
        rig = of("symmetric", seed, clean=0.0, common=1.0, **settings)
        p = rig.params
        ratio = p.tone / (2.0 * math.pi * rig.frequency)
        assert np.all((ratio >= 0.05) & (ratio <= 0.3))
        rms = math.sqrt(0.5 * (p.tone_amplitude[:, 0] ** 2).sum())
        assert 3.0 <= rms / (p.middle * math.sqrt(0.5)) <= 10.0 * 1.001


@pytest.mark.parametrize(
    ("name", "play"),
    [("narrow", 0.0), ("two-valleys", 0.0), ("two-modes", 0.0), ("symmetric", 0.05)],
)
def test_the_loop_runs_on_every_rig_with_the_truth_of_its_best_theta(
    name: str, play: float
) -> None:
    settings = {"noise_driven": 0.0, "amplitude_time": (2.0, 3.0), "clean": 1.0, "maximised": 0.0}
    rig = of(name, 4, play=(play, play), log_scaled=0.0, **settings)
    noise = noise_of(rig, round(60.0 * rig.time / rig.params.dt), 1)
    assert noise.best == pytest.approx(rig.best()[1], rel=1e-6)
    done = close(from_end(rig, 0), controller_of(rig, 0.1), noise, 1)
    amplitude = rig.record(done.theta, 1)[1]
    half = amplitude.size // 2
    again = math.sqrt(float((amplitude[half:] ** 2).mean())) / noise.best
    # only the first phase is another one: the controller's theta gives the same amplitude
    assert done.ratio == pytest.approx(again, rel=0.01)
    assert done.ratio > 0.99


def test_a_drowned_rig_shows_nothing_of_its_oscillation() -> None:
    rig = of("drowned", 1)
    x, amplitude = rig.record(np.full(50_000, rig.best()[0]), 0)
    assert x.std() > 30.0 * amplitude.max()
    assert not rig.has_optimum


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"depth": [20.0, 2.0]}, r"depth = \[20\.0, 2\.0\]: must be two numbers"),
        ({"frequency": [0.0, 1.0]}, "frequency = 0: must be 0.001 to 1000"),
        ({"quiet": 2.0}, "quiet = 2: must be 0 to 1"),
        ({"maps": {"round": 1.0}}, r"maps\.round = 1: known are symmetric"),
        ({"maps": {"flat": 0.0}}, "none has a weight above 0"),
        ({"deep": 1}, "unknown key 'deep': did you mean 'depth'"),
    ],
)
def test_a_wrong_family_is_refused_with_the_reason(settings: object, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        parse(FamilyConfig, settings, "family")


def test_compiled_and_plain_step_agree() -> None:
    for rig in map(drawn, range(10)):
        state = plain = rig.initial(1)
        for k, noise in enumerate(rig.noise(50, 1)):
            state = oscillator.step(rig.params, state, k, rig.theta_initial, *noise[:2])
            plain = oscillator.step.py_func(rig.params, plain, k, rig.theta_initial, *noise[:2])
        assert state == pytest.approx(plain, rel=1e-9)


def test_later_the_optimum_is_where_it_has_moved_to_and_goes_on_from_there() -> None:
    for seed in range(5, 9):
        rig = of("symmetric", seed, drift=(0.1, 0.1))
        period = 1.8 / abs(rig.params.drift)  # to one end of the range, to the other, and back
        for passed in (0.1 * period, 0.45 * period, 0.9 * period):
            after = rig.later(passed)
            for t in np.linspace(0.0, period, 7):
                assert after.best(float(t)) == pytest.approx(rig.best(passed + float(t)), rel=1e-6)
    still = of("symmetric", 5, **STILL)
    assert still.later(1e6) == still
