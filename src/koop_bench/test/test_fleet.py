"""Many loops at once."""

import pytest

from koop_bench.containers import fleet, parameters_at
from koop_bench.fleet import holds
from koop_bench.fleet_report import counts_of, report
from koop_core.config.parameter import ConfigError
from koop_core.stream.durations import Durations


def said(step, late=0, missed=0, answered=0, trip=1e-3):
    """Return what a loop says on /diagnostics."""
    trips = Durations()
    for _ in range(answered):
        trips.add(trip)
    return {
        "/a/vdp_plant": {
            "step": str(step), "late_ticks": str(late), "round_trips": trips.text(),
            "ticks_behind": "0:1",
        },
        "/a/koopman_lifter": {"state missed_steps": str(missed)},
        "/a/relay_esc": {"cost missed_steps": "0"},
    }  # fmt: skip


def between(before, after):
    first = counts_of("/a", before, {"/a/vdp_plant": 10.0})
    return report([first], [counts_of("/a", after, {"/a/vdp_plant": 12.0})], cpu=0.06)


def test_only_what_came_between_two_reports_counts():
    actual = between(
        said(100, late=7, missed=3, answered=90), said(500, late=8, missed=3, answered=490)
    )
    assert actual.slowest == 200.0
    assert (actual.ticks, actual.late, actual.lost) == (401, 1, 0)
    assert actual.trip(0.99) == pytest.approx(1e-3, rel=0.05)
    assert actual.cpu_per_loop == 0.06


@pytest.mark.parametrize(
    ("after", "expected"),
    [
        (said(2000, answered=2000), True),
        (said(2000, answered=2000, trip=6e-3), False),
        (said(2000, answered=1990), False),
        (said(2000, answered=2000, missed=1), False),
        (said(2000, answered=2000, late=3), False),
    ],
    ids=["kept", "slow", "unanswered", "lost", "missed ticks"],
)
def test_a_fleet_holds_where_all_is_in_time_and_nothing_lost(after, expected):
    assert holds(between(said(0), after)) is expected


def test_another_rate_is_another_time_scale_of_the_same_loop():
    assert parameters_at(200.0)["vdp_plant"]["pace"] == "realtime"
    plant = parameters_at(1000.0)["vdp_plant"]
    assert (plant["pace"], plant["time_scale"]) == ("scaled", 5.0)
    with pytest.raises(ConfigError):
        parameters_at(0.0)


def test_two_loops_in_two_containers_run_side_by_side(own_domain, tmp_path):
    """They do not hear each other: a second publisher of a topic would be an error."""
    with fleet(tmp_path, 2, parameters_at(200.0), containers=2) as running:
        running.wait_until_running(100)
        for each in running.counts():
            assert each.steps >= 100
            assert each.trips.count > 0
    logs = [(tmp_path / f"container{number}.log").read_text() for number in (0, 1)]
    assert [log.count("loop0.koopman_lifter") > 0 for log in logs] == [True, False]
    assert not any("publishers on" in log or "Traceback" in log for log in logs)
