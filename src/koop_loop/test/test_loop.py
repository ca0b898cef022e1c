"""The offline loop against the same kernels called step by step, and its claims."""

from dataclasses import replace

import numpy as np
import pytest

from koop_core.stream.arrival import Arrival
from koop_loop.loop import LoopDiverged, simulate
from koop_loop.metrics import evaluate
from koop_loop.parameters import make
from koop_loop.training import TrainingConfig, simulated_gram, train
from koopman_lifter import cost
from koopman_lifter.config import LifterConfig, shipped_model
from koopman_lifter.model import load
from relay_esc import relay
from relay_esc.config import EscConfig
from vdp_plant import dynamics
from vdp_plant.config import PlantConfig

# every limit where it acts: y_out passes 1e13 for some 2 % of the time
LIMITED = {
    "plant": PlantConfig(seed=3, theta_min=1.7, theta_max=2.2, theta_rate=0.04),
    "lifter": LifterConfig(y_out_max=1e13),
    "esc": EscConfig(dwell=2.0, theta_min=1.5, theta_max=2.1, rate_limit=0.06),
}


@pytest.mark.parametrize(
    "configs",
    [{"plant": PlantConfig(seed=3), "lifter": LifterConfig(), "esc": EscConfig()}, LIMITED],
)
def test_the_compiled_loop_is_the_kernels_called_one_by_one(configs):
    """As the nodes call them: an inlined kernel must round like a called one."""
    plant, lifter, esc = configs["plant"], configs["lifter"], configs["esc"]
    model = load(shipped_model())
    result = simulate(plant, lifter, esc, model, 4000)
    x, y = dynamics.initial_state(3)
    detector, state, work = cost.initial(), esc.initial(), cost.workspace(model.lifting())
    applied = plant.theta_initial
    for k in range(4000):
        arrival = int(Arrival.NEXT if k else Arrival.RESTART)
        measured = np.array(dynamics.measure(plant.params(), k, x, y))
        r, _, settling, detector = cost.answer(
            cost.LIFTED,
            model.lifting(),
            lifter.detector_params(),
            detector,
            arrival,
            k,
            measured,
            work,
        )
        state, _, _ = relay.answer(esc.params(plant.dt), state, arrival, False, settling, r, False)
        np.testing.assert_equal((result.r[k], result.theta[k]), (r, state.output))
        assert result.measured[k].tolist() == measured.tolist()
        x, y, applied = dynamics.advance(plant.params(), k, x, y, applied, state.output)


def test_unusable_states_hold_theta_and_the_run_goes_on():
    model = load(shipped_model())
    result = simulate(**LIMITED, model=model, steps=20_000)
    unusable = np.flatnonzero(np.isnan(result.r))
    assert 100 < unusable.size < 10_000
    assert (result.theta[unusable[1:]] == result.theta[unusable[1:] - 1]).all()
    energies = [np.sum((model.projector @ model.observables.lift(x)) ** 2) for x in result.measured]
    assert (np.isnan(result.r) == (np.array(energies) > 1e13)).all()


def test_the_limits_of_the_controller_and_of_the_actuator_act():
    model, lifter = load(shipped_model()), LifterConfig()
    plant, esc = LIMITED["plant"], replace(LIMITED["esc"], dwell=1e3)  # it never turns
    result = simulate(plant, lifter, esc, model, 4000)
    assert np.abs(np.diff(result.theta)).max() == pytest.approx(0.06 * 0.005, rel=1e-9)
    assert result.theta[-1] == 1.5
    # to the oscillator, an actuator of 0.04 a second that stops at 1.7 is a controller that does
    free = replace(plant, theta_min=-9.0, theta_max=9.0, theta_rate=0.0)
    stopped = replace(esc, theta_min=1.7, rate_limit=0.04)
    other = simulate(free, lifter, stopped, model, 4000)
    np.testing.assert_array_equal(other.ground_truth, result.ground_truth)
    assert other.theta[-1] == 1.7


def run(duration, seed):
    """Run the loop with the shipped model."""
    loop = make({"vdp_plant": {"duration": duration, "seed": seed}})
    return simulate(loop.plant, loop.lifter, loop.esc, loop.load_model(), round(duration / 0.005))


def test_the_lifted_loop_converges_below_the_paper_s_integral_error():
    result = run(2500.0, seed=0)
    metrics = evaluate(result.t, result.theta, result.r, PlantConfig().theta_star, None)
    assert metrics.converged
    assert metrics.iae_theta < 1445.3
    assert metrics.t_theta < 258.0


def test_the_same_seed_gives_the_same_run_and_another_seed_another():
    first, again = run(20.0, seed=4), run(20.0, seed=4)
    np.testing.assert_array_equal(first.measured, again.measured)
    assert (run(20.0, seed=5).measured != first.measured).any()


def test_a_diverging_plant_is_reported_with_its_time():
    plant = PlantConfig(initial_state=(1000.0, 1000.0))
    with pytest.raises(LoopDiverged, match=r"diverged at t = 0\.\d+ s: use a smaller dt"):
        simulate(plant, LifterConfig(cost="raw"), EscConfig(), None, 1000)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lifter": LifterConfig(dt=0.01)}, "dt differs: plant 0.005, lifter 0.01 s"),
        ({"esc": EscConfig(theta_initial=1.0)}, "theta_initial differs: plant 2.0, esc 1.0"),
        ({"model": None}, "the lifted cost needs a model"),
    ],
)
def test_parts_that_do_not_belong_together_are_refused(change, message):
    parts = {
        "plant": PlantConfig(),
        "lifter": LifterConfig(),
        "esc": EscConfig(),
        "model": load(shipped_model()),
    } | change
    with pytest.raises(ValueError, match=message):
        simulate(**parts, steps=10)


def test_one_number_for_all_knobs_is_what_a_list_of_it_is():
    """Failed before: theta_initial differs: plant 2.0, esc (2.0, 2.0)."""
    plant, lifter = PlantConfig(theta_star=(-3.0, 1.0)), LifterConfig(cost="raw")
    each, all_of_them = (
        simulate(plant, lifter, EscConfig(theta_initial=begin, theta_min=(-5.0, -4.0)), None, 50)
        for begin in ((2.0, 2.0), 2.0)
    )
    np.testing.assert_array_equal(each.theta, all_of_them.theta)


def test_training_again_gives_the_shipped_model():
    again, shipped = train(PlantConfig(), TrainingConfig()), load(shipped_model())
    assert again.provenance == shipped.provenance
    np.testing.assert_array_equal(again.kept, shipped.kept)
    # another machine's BLAS may sum in another order; the eigenvalues are conditioned like 1e3
    np.testing.assert_allclose(again.eigenvalues, shipped.eigenvalues, rtol=1e-8)
    np.testing.assert_allclose(again.K, shipped.K, rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(again.energies, shipped.energies, rtol=1e-5)


def test_a_diverging_trajectory_is_dropped_and_counted():
    far = TrainingConfig(trajectories=20, duration=20.0, theta_low=-12.0, theta_high=12.0)
    gram, dropped = simulated_gram(PlantConfig(), far)
    assert 0 < dropped < 20
    assert gram.pairs == (20 - dropped) * 4000
    assert np.isfinite(gram.xx).all()


def test_training_without_interference_sees_the_true_state():
    config = TrainingConfig(trajectories=3, duration=10.0, corrupted=False)
    clean, _ = simulated_gram(PlantConfig(), config)
    corrupted, _ = simulated_gram(PlantConfig(), replace(config, corrupted=True))
    assert clean.xx[1, 1] < corrupted.xx[1, 1]
