"""The plant from tables is the plant, to the last bit."""

import numpy as np

from vdp_plant import dynamics
from vdp_plant.config import PlantConfig
from vdp_plant.waves import LONGEST, advance, interference_of, measure, waves_of

TABLE, STEPS = 300, 400  # those after the table evaluate their own sines


def test_a_run_from_tables_is_the_run_to_the_last_bit():
    p = PlantConfig(theta_rate=0.5, theta_max=2.2).params()
    waves = waves_of(p, TABLE)
    assert waves.interference.size == TABLE
    assert len(waves.drive) == TABLE
    theirs = ours = (1.0, 2.0, 1.5)
    for k in range(STEPS):
        assert measure(p, waves, k, *ours[:2]) == dynamics.measure(p, k, *theirs[:2])
        theta, displaced = 1.5 + np.sin(0.05 * k), 0.001 * k
        theirs = dynamics.advance(p, k, *theirs, theta, displaced)
        ours = advance(p, waves, k, *ours, theta, displaced)
        assert ours == theirs
    assert np.isfinite(ours).all()


def test_a_table_does_not_grow_with_the_longest_of_runs():
    assert interference_of(PlantConfig().params(), 2 * LONGEST).size == LONGEST
