"""What `koop bench identify` compares is the same identification, in memory that stays the same."""

import sys
from pathlib import Path

import numpy as np
import pytest

from koop_bench.identify import (
    difference,
    identify,
    make_recording,
)
from koop_core.errors import KoopError


def test_the_recording_is_identified_as_numpy_does_it_whole(tmp_path):
    file = tmp_path / "samples.npy"
    np.save(file, make_recording(300_016))
    figures = {
        name: identify(Path(sys.executable), name, file, 4, 2, 300_000)
        for name in ("koop", "numpy")
    }
    ours, whole = figures["koop"], figures["numpy"]
    assert ours.eigenvalues.size == 15
    assert difference(ours.eigenvalues, whole.eigenvalues) < 1e-9
    # all lifted states together are 36 MB
    assert ours.memory < 20e6 < 36e6 < whole.memory


def test_spectra_are_compared_eigenvalue_by_eigenvalue():
    ours = np.array([1.0, 0.9 + 0.1j, 0.9 - 0.1j, 0.2])
    assert difference(ours, np.array([0.2, 0.9 - 0.1j, 0.9 + 0.13j])) == pytest.approx(0.03)


def test_a_tool_that_is_not_installed_is_an_error_that_says_so(tmp_path):
    file = tmp_path / "samples.npy"
    np.save(file, make_recording(100))
    bare = tmp_path / "python"
    bare.write_text(f'#!/bin/sh\nexec {sys.executable} -S "$@"\n')
    bare.chmod(0o755)
    with pytest.raises(KoopError, match=r"No module named|is not installed"):
        identify(bare, "pykoop", file, 1, 1, 50)
