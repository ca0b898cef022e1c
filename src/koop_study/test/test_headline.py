"""Headline runs: what the nodes get is what the offline loop runs; comparison sees every bit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from koop_core.errors import InputError
from koop_loop.loop import LoopResult, simulate
from koop_study.over_dds import compare, headline
from koop_study.simulation.case import Case, override
from koopman_lifter.config import LifterConfig
from relay_esc.config import EscConfig
from vdp_plant.config import PlantConfig


@pytest.fixture
def offline() -> LoopResult:
    return simulate(PlantConfig(), LifterConfig(cost="raw"), EscConfig(), None, 2000)


def columns(run: LoopResult) -> dict[str, np.ndarray]:
    return {
        "step": run.step,
        "measured": run.measured.copy(),
        "r": run.r.copy(),
        "theta": run.theta,
    }


def test_a_headline_runs_on_the_nodes_own_loop() -> None:
    item = headline("short", override(Case(), {"cost": "contrast", "duration": 5.0}))
    assert item.model is not None
    assert item.offline().theta.size == 1000


def test_what_the_nodes_cannot_run_is_refused() -> None:
    with pytest.raises(InputError, match="cannot run 'x'"):
        headline("x", override(Case(), {"scenario.noise": 1.0}))


def test_the_same_run_has_no_difference(offline: LoopResult) -> None:
    assert compare(offline, columns(offline)) == {}


@pytest.mark.parametrize("column", ["measured", "r", "theta"])
def test_one_bit_in_one_row_is_found(offline: LoopResult, column: str) -> None:
    recorded = columns(offline)
    changed = recorded[column].copy()
    changed[1234] = np.nextafter(changed[1234], np.inf)
    found = compare(offline, {**recorded, column: changed})
    assert list(found) == [column]
    assert (found[column].first, found[column].count) == (1234, 1)
    assert 0.0 < found[column].largest < 1e-12


def test_a_lost_step_is_found(offline: LoopResult) -> None:
    recorded = {name: np.delete(values, 77, axis=0) for name, values in columns(offline).items()}
    found = compare(offline, recorded)
    assert list(found) == ["step"]
    assert found["step"].first == 77


def test_a_run_that_ended_early_is_found(offline: LoopResult) -> None:
    recorded = {name: values[:1500] for name, values in columns(offline).items()}
    found = compare(offline, recorded)
    assert list(found) == ["step"]
    assert (found["step"].first, found["step"].count) == (1500, 500)


def test_another_seed_is_another_run(offline: LoopResult) -> None:
    other = simulate(
        replace(PlantConfig(), seed=1), LifterConfig(cost="raw"), EscConfig(), None, 2000
    )
    assert set(compare(offline, columns(other))) >= {"measured", "r"}
