"""The C source of the offline benchmark is the same loop."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from koop_bench.offline import SOURCE, STEPS, c_run, compile_c, kernel_run
from koop_core.errors import KoopError
from koop_loop.training import TrainingConfig, train
from koopman_lifter.config import LifterConfig
from vdp_plant.config import PlantConfig


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler 'cc' on the PATH")
@pytest.mark.parametrize("cost", ["raw", "lifted"])
def test_c_and_kernel_agree_over_the_whole_run(cost: str, tmp_path: Path) -> None:
    training = TrainingConfig(trajectories=20, duration=20.0)
    model = None if cost == "raw" else train(PlantConfig(), training)
    loop = LifterConfig(cost=cost), model
    theta, theta_c = kernel_run(*loop)(), c_run(*loop, compile_c(SOURCE, tmp_path))()
    # not chaotic, but a flip of the relay may move by a step where sin() rounds differently
    assert np.abs(theta - theta_c).max() < 1e-6
    assert theta.size == theta_c.size == STEPS
    assert np.ptp(theta) > 1.0


def test_a_source_that_does_not_compile_is_an_error(tmp_path: Path) -> None:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler 'cc' on the PATH")
    source = tmp_path / "x.c"
    source.write_text("int main(void) { return oops; }\n")
    with pytest.raises(KoopError, match="does not compile"):
        compile_c(source, tmp_path)
