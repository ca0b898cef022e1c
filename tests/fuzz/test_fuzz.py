"""A short run of the fuzzer, and that it finds what is wrong."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

import fuzz

# Inputs and a seed with which they reach as many of the checks as 1500 of another seed do.
INPUTS = {"model": (600, 2), "bag": (600, 5), "fields": (1500, 7), "words": (1500, 7),
          "scenario": (800, 7)}  # fmt: skip


@pytest.fixture(scope="module")
def targets(tmp_path_factory):
    return fuzz.targets(tmp_path_factory.mktemp("fuzz"))


@pytest.mark.parametrize("name", INPUTS)
def test_arbitrary_input_is_refused_or_works(targets, name):
    trial, expected = targets[name]
    inputs, seed = INPUTS[name]
    outcome = fuzz.fuzz(trial, expected, inputs, seed)
    assert outcome.findings == []
    assert outcome.inputs == inputs
    assert len(outcome.answers) > 20  # kinds of refusal; a fuzzer that reaches none finds nothing


def test_the_fuzzer_finds_what_is_not_refused():
    def trial(rng):
        if rng.random() < 0.1:
            raise KeyError("unexpected")
        raise ValueError

    outcome = fuzz.fuzz(trial, (ValueError,), 200, seed=0)
    assert 5 < len(outcome.findings) < 40
    assert "KeyError('unexpected')" in outcome.findings[0]
