"""The offline loop against the same kernels called step by step, and its claims."""

from dataclasses import replace

import numpy as np
import pytest

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


def test_the_compiled_loop_is_the_kernels_called_one_by_one():
    """As the nodes call them: an inlined kernel must round like a called one."""
    plant, lifter, esc, model = (
        PlantConfig(seed=3),
        LifterConfig(),
        EscConfig(),
        load(shipped_model()),
    )
    result = simulate(plant, lifter, esc, model, 4000)
    x, y = dynamics.initial_state(3)
    detector, state, z = cost.initial(), esc.initial(), np.empty(10)
    for k in range(4000):
        measured = np.array(dynamics.measure(plant.params(), k, x, y))
        r, _, detector = cost.step(
            cost.LIFTED, model.lifting(), lifter.detector_params(), detector, measured, z
        )
        state = relay.step(esc.params(), state, r)
        assert (result.r[k], result.theta[k]) == (r, state.theta)
        assert result.measured[k].tolist() == measured.tolist()
        x, y = dynamics.step(plant.params(), k, x, y, state.theta)


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
    plant = PlantConfig(integrator="euler", initial_state=(300.0, 300.0))
    with pytest.raises(LoopDiverged, match=r"diverged at t = 0\.\d+ s: use the rk4 integrator"):
        simulate(plant, LifterConfig(cost="raw"), EscConfig(), None, 1000)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lifter": LifterConfig(dt=0.01)}, "dt differs: plant 0.005, lifter 0.01, esc 0.005 s"),
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


def test_training_again_gives_the_shipped_model():
    again, shipped = train(PlantConfig(), TrainingConfig()), load(shipped_model())
    assert again.provenance == shipped.provenance
    np.testing.assert_array_equal(again.kept, shipped.kept)
    # another machine's BLAS may sum in another order; the eigenvalues are conditioned like 1e3
    np.testing.assert_allclose(again.eigenvalues, shipped.eigenvalues, rtol=1e-8)
    np.testing.assert_allclose(again.K, shipped.K, rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(again.energies, shipped.energies, rtol=1e-5)


def test_a_diverging_trajectory_is_dropped_and_counted():
    plant = PlantConfig(integrator="euler", dt=0.02)
    gram, dropped = simulated_gram(plant, TrainingConfig(trajectories=20, duration=20.0))
    assert 0 < dropped < 20
    assert gram.pairs == (20 - dropped) * 1000
    assert np.isfinite(gram.xx).all()


def test_training_without_interference_sees_the_true_state():
    config = TrainingConfig(trajectories=3, duration=10.0, corrupted=False)
    clean, _ = simulated_gram(PlantConfig(), config)
    corrupted, _ = simulated_gram(PlantConfig(), replace(config, corrupted=True))
    assert clean.xx[1, 1] < corrupted.xx[1, 1]
