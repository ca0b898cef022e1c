"""Several knobs on the paper's plant, offline."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import koop_hil
from koop_loop.loop import simulate
from koop_loop.parameters import make

MODEL = Path(koop_hil.__file__).parent / "models/contrast.npz"


@pytest.mark.parametrize("seed", range(4))
def test_two_rotated_knobs_find_the_optimum_of_the_papers_plant(seed):
    start, best = [2.0, 1.0], [-3.0, 1.0]
    loop = make(
        {
            "vdp_plant": {
                "theta_star": best, "theta_initial": start, "coupling": [0.8, 0.6, -0.6, 0.8],
                "seed": seed,
            },
            "koopman_lifter": {"model": str(MODEL), "omega_h": 100.0},
            "relay_esc": {
                "law": "adaptive", "theta_initial": start, "tau_f": 3.0, "dwell": 8.0,
            },
        }
    )  # fmt: skip
    run = simulate(loop.plant, loop.lifter, loop.esc, loop.load_model(), 300_000)
    distance = np.linalg.norm(run.theta - best, axis=1)
    assert distance[0] == 5.0
    assert distance[-90_000:].mean() < 0.5  # as with one knob: it has converged
