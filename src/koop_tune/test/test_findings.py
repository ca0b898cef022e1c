"""Whether there is an optimum to seek, and which cost leads to it."""

import re
from dataclasses import replace

import numpy as np
import pytest
from surrogate_rigs import make_cost, make_findings, make_map

from koop_tune.result.as_text import as_table
from koop_tune.result.summary import summarise_refusal
from koop_tune.rig.rig_file import RigFile
from koop_tune.search.findings import NoOptimum, decide, find_corners
from koop_tune.search.settings import TUNING

RIG = RigFile("/a:x", "/b:z", 0.02, 0.0, 1.0, 0.5, 0.5, 0.5)


def valley(u):
    return 4.0 * (u - 0.5) ** 2


def sharp(u):
    return 8.0 * np.abs(u - 0.5)


def slight(u):
    """Most gets worse above 0.2, little below."""
    return np.where(u > 0.2, 2.0 * (u - 0.2), 0.2 * (0.2 - u))


def judge(level, *costs, error=0.05, settings=TUNING):
    observed = make_findings(level, costs, error)
    return decide(observed, RIG, settings)


def test_a_clear_optimum_that_a_cost_shows_is_taken_without_doubt():
    actual = judge(valley, make_cost("raw", valley), make_cost("lifted", None))
    assert actual.doubt == ""
    raw, lifted = actual.costs
    assert list(raw.usable) == [4.0]
    assert raw.evidence == pytest.approx(make_map(valley).evidence)
    assert not lifted.usable
    assert (lifted.evidence, lifted.clearest) == (0.0, None)


@pytest.mark.parametrize(
    ("level", "error", "kind", "message"),
    [
        (lambda u: 0.0 * u, 0.05, "flat", r"varies by 0 %, with errors of 5 %.*run 'koop check'"),
        (lambda u: 0.05 * u, 1e-3, "flat", "varies by 5.1 %"),  # treated as flat, however sharp
        (lambda u: 2.0 * u, 0.05, "monotone", "best at theta_min = 0, the limit"),
        (lambda u: -2.0 * u, 0.05, "monotone", "best at theta_max = 1.*leave theta there"),
        (valley, 0.05, "drowned", r"optimum near 0.5, but no cost shows it \(evidence 0.0\)"),
    ],
)
def test_where_there_is_nothing_to_seek_it_says_what_to_record(level, error, kind, message):
    with pytest.raises(NoOptimum, match=message) as refused:
        judge(level, make_cost("raw", lambda u: 0.0 * u), error=error)
    assert refused.value.kind == kind
    assert len(str(refused.value).splitlines()) == 1
    assert re.search("record", str(refused.value))


def test_a_cost_that_clearly_leads_elsewhere_is_not_said_to_be_drowned():
    elsewhere = make_cost("raw", lambda u: 30.0 * (u - 0.125) ** 2, reference=valley)
    with pytest.raises(NoOptimum, match=r"near 0.5, but the cost raw leads to 0.125: it sums"):
        judge(valley, elsewhere)


def test_an_optimum_that_moved_to_the_limit_may_turn_round():
    findings = make_findings(lambda u: 2.0 * u, [make_cost("raw", lambda u: 2.0 * u)])
    moved = replace(findings, static_map=replace(findings.static_map, motion=-0.2))
    assert "towards theta_min is not certain" in decide(moved, RIG).doubt
    told, still = (as_table(summarise_refusal(NoOptimum("", "", f))) for f in (moved, findings))
    assert "moved by -20 % of the range" in told
    assert "moved" not in still


def test_an_optimum_in_doubt_is_taken_and_said():
    actual = judge(slight, make_cost("raw", slight))
    assert "towards theta_min is not certain (errors of 5 %)" in actual.doubt
    assert actual.costs[0].usable  # it leads to where the amplitude does
    assert not replace(actual.costs[0], near=1e-3, reference=make_map(valley)).usable


def test_a_cost_in_doubt_must_lead_to_where_the_amplitude_does():
    def one_sided(u):  # whether it gets worse above 0.5 is not seen
        return np.where(u > 0.5, 0.05 * (u - 0.5), valley(u))

    unsure = make_cost("raw", one_sided, error=0.08, reference=valley)
    assert not unsure.usable
    actual = judge(valley, unsure)
    assert actual.doubt.startswith("no cost shows the optimum")
    assert actual.costs[0].usable
    wrong = make_cost("raw", lambda u: one_sided(u + 0.35), error=0.08, reference=sharp)
    with pytest.raises(NoOptimum, match="no cost shows it"):
        judge(sharp, wrong)


def test_no_corner_frequency_is_beyond_half_of_the_sampling_rate():
    """As of a mill that chatters at 19.2 Hz and is measured at 250 Hz."""
    dt = 0.004
    corners = find_corners(TUNING.highpass, 0.052, dt)
    assert corners[:2] == pytest.approx([2.0 * np.pi / 0.052, 6.0 * np.pi / 0.052])
    assert corners[2:] == pytest.approx([np.pi / dt] * 2)
