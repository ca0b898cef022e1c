"""The study's runs are the nodes' loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from koop_lab.commands.simulate import run as simulated
from koop_loop.loop import LoopDiverged, simulate
from koop_loop.metrics import LOGGING_START
from koop_loop.parameters import make
from koop_loop.training import train
from koop_study.simulation.case import Case, override, seeded
from koop_study.simulation.run import measure, model_of, run
from koop_study.simulation.work import runs, trace
from vdp_plant.config import PlantConfig

SHORT = {"duration": 150.0, "training.trajectories": 10, "training.duration": 10.0}


@pytest.mark.parametrize("cost", ["raw", "lifted"])
def test_it_is_the_nodes_loop_to_the_last_bit(cost: str) -> None:
    case = seeded(override(Case(), {**SHORT, "cost": cost}), 7)
    model = train(PlantConfig(), case.training)
    expected = simulate(case.plant, replace(case.lifter, cost=cost), case.esc, model, case.steps)
    done = run(case)
    assert done.theta.tobytes() == expected.theta.tobytes()
    assert done.r.tobytes() == expected.r.tobytes()
    assert done.ground_truth.tobytes() == expected.ground_truth.tobytes()


@pytest.mark.parametrize("duration", [50.0, 101.0, 200.0])
def test_a_run_of_any_length_is_drawn(duration: float) -> None:
    drawn = trace({"cost": "raw", "duration": duration})
    first = 0.0 if duration <= LOGGING_START else LOGGING_START
    assert drawn["t"][0] == pytest.approx(first)
    assert first < drawn["t"][-1] < duration
    for name in ("x", "r", "theta"):
        assert [len(edge) for edge in drawn[name]] == [len(drawn["t"])] * 2


LIMITS = {  # each of them acts within a minute; y_out_max in 2 % of the states
    "plant.theta_min": 1.7, "plant.theta_max": 2.2, "plant.theta_rate": 0.04,
    "lifter.y_out_max": {"raw": 26.0, "lifted": 1e13},
    "esc.dwell": 1.0, "esc.theta_min": 1.5, "esc.theta_max": 2.1, "esc.rate_limit": 0.06,
}  # fmt: skip


def limited(cost: str, **settings: object) -> Case:
    limits = {name: v[cost] if isinstance(v, dict) else v for name, v in LIMITS.items()}
    return seeded(
        override(Case(), {**SHORT, "duration": 60.0, "cost": cost} | limits | settings), 3
    )


@pytest.mark.parametrize("name", LIMITS)
def test_no_limit_is_silently_ignored(name: str) -> None:
    """Theta is led through all of them: down at first, up later."""
    default = {path: getattr(getattr(Case(), part), field) for path in LIMITS
               for part, _, field in [path.partition(".")]}  # fmt: skip
    only = limited("raw", **{path: value for path, value in default.items() if path != name})
    only = override(only, {"esc.dwell": 1e4, **({"esc.dwell": 1.0} if name == "esc.dwell" else {})})
    if name.endswith("theta_max"):  # theta begins in the lower half, and goes up
        only = override(only, {"esc.theta_min": 1.99})
    without = override(only, {name: default[name]})
    actual, free = (run(case).ground_truth for case in (only, without))
    assert not np.array_equal(actual, free)


def test_a_run_has_the_figures_that_koop_simulate_prints() -> None:
    case = override(Case(), {"cost": "raw", "duration": 150.0})
    ours = measure(case, run(case), with_r_star=True)
    values = {"koopman_lifter": {"cost": "raw"}, "vdp_plant": {"duration": 150.0}}
    _, theirs = simulated(make(values))
    assert ours["iae"] == theirs.iae_theta
    assert ours["ise"] == theirs.ise_theta
    assert ours["t_theta"] == theirs.t_theta
    assert ours["tail"] == theirs.tail_error
    assert ours["e_r_ss"] == theirs.e_r_ss is not None


def test_a_run_that_diverges_counts_as_the_worst() -> None:
    settings = {"duration": 50.0, "cost": "raw", "plant.initial_state": [1e3, 1e3]}
    with pytest.raises(LoopDiverged):
        run(override(Case(), settings))
    (row,) = runs(settings, [0])
    assert row["iae"] == np.inf
    assert row["converged"] == 0.0


def test_seeds_draw_state_model_and_phases_and_nothing_else() -> None:
    one, two = seeded(Case(), 1), seeded(Case(), 2)
    assert one == seeded(Case(), 1)
    assert one.plant.seed != two.plant.seed
    assert one.training.seed != two.training.seed
    assert one.plant.interference_phase_1 != two.plant.interference_phase_1
    assert (one.lifter, one.esc) == (two.lifter, two.esc)
    raw = override(one, {"cost": "raw"})
    assert model_of(raw) is None
