"""What `koop bench identify` compares is the same identification, in memory that stays the same."""

import numpy as np
import pytest

from koop_bench.identify import difference, identify, make_recording


def test_the_recording_is_identified_as_numpy_does_it_whole(tmp_path):
    file = tmp_path / "samples.npy"
    np.save(file, make_recording(150_016))
    ours, whole = (identify(name, file, 4, 150_000) for name in ("koop", "numpy"))
    assert ours.eigenvalues.size == 35
    assert difference(ours.eigenvalues, whole.eigenvalues) < 1e-6
    # all lifted states together are 42 MB
    assert ours.memory < 25e6 < 42e6 < whole.memory


def test_one_that_fails_is_an_error_that_says_why(tmp_path):
    with pytest.raises(OSError, match="No such file"):
        identify("numpy", tmp_path / "samples.npy", 1, 50)
