"""A short run of the fuzzer, and that it finds what is wrong."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

import fuzz


@pytest.mark.parametrize("name", ["model", "bag", "fields", "words", "scenario"])
def test_arbitrary_input_is_refused_or_works(tmp_path, name):
    trial, expected = fuzz.targets(tmp_path)[name]
    outcome = fuzz.fuzz(trial, expected, 1500, seed=7)
    assert outcome.findings == []
    assert outcome.inputs == 1500


def test_the_fuzzer_finds_what_is_not_refused():
    def trial(rng):
        if rng.random() < 0.1:
            raise KeyError("unexpected")
        raise ValueError

    outcome = fuzz.fuzz(trial, (ValueError,), 200, seed=0)
    assert 5 < len(outcome.findings) < 40
    assert "KeyError('unexpected')" in outcome.findings[0]
