"""An excitation's decisions, on simulated rigs of which map, settling time and noise are known."""

import math
from dataclasses import replace

import numpy as np
import pytest

from koop_core.errors import InputError
from koop_tune.excitation import static_map
from koop_tune.excitation.design import (
    DESIGN,
    FLAT,
    GAP,
    KNOWN,
    TIME,
    Design,
    Move,
    first_positions,
)
from koop_tune.excitation.holds import HOLDS, Hold
from koop_tune.rig.rig_file import RigFile

DT, PERIOD, SLOW = 0.02, 0.5, 0.08
COUNT = 2 * DESIGN.first - 1  # first positions, up and down
RIG = RigFile(
    "/a:x", "/b:z", DT, -1.0, 3.0, 0.5, 0.0, 0.5, time=3000.0
)  # fmt: skip


def absorber(width, depth, place):
    """Return log A(u) of a valley that is ``width`` wide at 1.5 times its floor, 1 / ``depth``.

    A = hypot(floor, k d), at most 1: as a tuned absorber, with sides that rise like the distance.
    """
    floor = 1.0 / depth
    k = floor * math.sqrt(1.5**2 - 1.0) / (0.5 * width)
    return lambda u: math.log(min(math.hypot(floor, k * abs(u - place)), 1.0))


def wide(u):
    """Return log A(u) of a valley that is half the range wide."""
    return 3.0 * (u - 0.4) ** 2


class Simulated:
    """A sine of 2 Hz whose log amplitude follows level(u, side) at once, or with a time constant.

    Every half second its power is drawn from a gamma distribution, of a deviation ``noise`` of the
    log amplitude; a line of 0.4 Hz, slower than the oscillation, does not react. An oscillation of
    0.08 Hz may, whose amplitude is ``slow(u)``.
    """

    def __init__(self, level, noise=0.05, tau=0.0, interference=0.0, sides=None, seed=0, slow=None):
        self.level, self.noise, self.tau, self.line = level, noise, tau, interference
        self.slow, self.slow_frequency = slow or (lambda u: 0.0), SLOW
        self.sides, self.rng = sides, np.random.default_rng(seed)
        self.u, self.side, self.seconds = RIG.u_start, 0, 0.0
        self.value, self.drawn = self.target, np.empty(0)

    @property
    def target(self):
        return self.level(self.u) + (self.sides(self.u, self.side) if self.sides else 0.0)

    def go(self, u):
        if u != self.u:
            self.side, self.u = (1 if u > self.u else -1), u

    def stay(self, samples):
        span = np.arange(1, samples + 1) * DT
        t = self.seconds + span
        self.seconds = t[-1]
        keep = np.exp(-span / self.tau) if self.tau else 0.0 * span
        value = self.target + keep * (self.value - self.target)
        self.value = value[-1]
        shape = 0.25 / self.noise**2
        more = max(int(t[-1] / PERIOD) + 2 - self.drawn.size, 0)
        self.drawn = np.r_[self.drawn, np.sqrt(self.rng.gamma(shape, size=more) / shape)]
        comes = np.interp(t / PERIOD, np.arange(self.drawn.size), self.drawn)
        x = np.exp(value) * comes * np.sin(2.0 * np.pi * t / PERIOD)
        x += self.slow(self.u) * np.sin(2.0 * np.pi * self.slow_frequency * t)
        x += self.line * np.sin(2.0 * np.pi * 0.4 * t) + 1e-3 * self.rng.normal(size=samples)
        return x[:, None]


def excite(rig, file=RIG, holds=(), settings=DESIGN, most=None):
    """Excite a rig with one knob."""
    return run(Design(file, holds, settings=settings), rig, most)


def run(design, rig, most=None):
    """Excite a rig as `koop excite` does; return the design and its moves."""
    heard = rig.stay(round(DESIGN.shortest / DT))
    while design.listens(heard):
        heard = np.concatenate([heard, rig.stay(100)])
    design.look(heard)
    moves = []
    while (most is None or len(moves) < most) and (move := design.next()) is not None:
        moves.append(move)
        for u in (move.via, move.u):
            if u is not None:
                rig.go(u)
        design.arrive(move, rig.seconds)
        while not design.take(rig.stay(design.windows.length)):
            assert rig.seconds < 2.0 * design.rig.time
    return design, moves


@pytest.fixture(scope="module")
def plain():
    """Excite the rig of the wide valley: its design, which is not to be changed, and the moves."""
    return excite(Simulated(wide))


def test_a_narrow_deep_valley_is_found_within_twice_the_holds_of_a_wide_one(plain):
    counts = []
    for seed, place in enumerate((0.31, 0.87)):
        level = absorber(0.02, 50.0, place)
        design, moves = excite(Simulated(level, seed=seed))
        best = design.static_map().best()
        assert level(best) < math.log(1.5 / 50.0)  # the floor is seen, not its side
        valley = design.static_map().valley()
        assert valley.width < 0.06
        counts.append(len(moves))
    assert np.mean(counts) <= 2.0 * len(plain[1])


def test_the_map_is_that_of_the_rig_and_both_sides_of_the_best_are_visited(plain):
    design, moves = plain
    assert design.ended == KNOWN
    assert [move.u for move in moves[:COUNT]] == first_positions(DESIGN.first, True)
    found = design.static_map()
    assert abs(found.best() - 0.4) < 0.1
    exact = np.array([wide(u) for u in found.grid])
    off = found.curve - exact
    assert np.abs(off - np.median(off)).max() < 0.15
    best = found.best()
    sides = {hold.side for hold in design.holds if abs(hold.u - best) < 0.1}
    assert sides == {1, -1}


def test_an_optimum_that_moves_is_found_where_it_is_at_the_end():
    rig = Simulated(wide)
    rig.level = lambda u: 6.0 * (u - 0.3 - rig.seconds / 4000.0) ** 2
    design, _ = excite(rig)
    way = design.static_map().motion
    assert design.ended == KNOWN
    assert way == pytest.approx(rig.seconds / 4000.0, abs=0.05)
    assert design.static_map().best() == pytest.approx(0.3 + rig.seconds / 4000.0, abs=0.06)


@pytest.mark.parametrize("slope", [1.5, -1.5])
def test_a_monotone_map_ends_with_its_best_at_the_limit(slope):
    design, moves = excite(Simulated(lambda u: slope * (u - 0.5)))
    assert design.ended == KNOWN
    assert design.static_map().best_end == (0.0 if slope > 0.0 else 1.0)
    assert len(moves) < 30


def test_a_rig_that_does_not_react_ends_flat_after_gaps_were_looked_into_and_all_visited_again():
    design, moves = excite(Simulated(lambda u: 0.0, seed=1))
    assert design.ended == FLAT
    assert [move.why for move in moves].count(GAP) == COUNT - 1
    assert len(moves) == DESIGN.rounds * COUNT + COUNT - 1
    assert [hold.why for hold in design.holds] == [move.why for move in moves[-COUNT:]]
    assert design.next() is None


def test_a_valley_between_the_first_positions_is_found_where_none_of_them_reacts():
    level = absorber(0.012, 5.0, 0.365)
    assert {level(u) for u in first_positions(DESIGN.first, True)} == {0.0}
    design, _ = excite(Simulated(level))
    assert design.ended == KNOWN
    assert abs(design.static_map().best() - 0.365) < 0.006


def test_the_best_of_a_deep_valley_is_known_as_well_as_a_verdict_needs():
    design, _ = excite(Simulated(lambda u: 8.0 * abs(u - 0.4), noise=0.5, seed=3))
    pairs = zip(design.holds, design.levels(), strict=True)
    errors = [level.error for hold, level in pairs if hold.confirms]
    assert design.ended == KNOWN
    assert max(errors) <= DESIGN.error_of_best < DESIGN.error_of_span * 8.0 * 0.6


def test_what_was_held_long_enough_for_longer_windows_is_not_held_again():
    first, _ = excite(Simulated(wide), most=COUNT)
    long = round(first.windows.length * 4 * DESIGN.fewest)
    for hold in first.holds[:3]:
        hold.append(np.resize(hold.x, (long, 1)))
    kept = [hold.u for hold in first.holds[:3]]
    move = first._look_again(4 * first.windows.length, "it is slower")
    assert [hold.u for hold in first.holds] == kept
    left = [move.u, *first._queue[1:]]
    assert sorted([*kept, *left]) == sorted(first_positions(DESIGN.first, True))
    assert first.since == 0.0
    assert "longer windows: it is slower" in move.why


def test_where_theta_was_held_too_short_for_what_reacts_it_goes_again_at_once():
    design, moves = excite(Simulated(wide), settings=replace(DESIGN, before=2.0))
    assert design.windows.seconds > 6.0 * PERIOD
    least = DESIGN.brief * design.windows.length
    assert all(hold.size >= least for hold in design.holds)
    first = [move.u for move in moves[: len(moves) - len(design.holds) + COUNT]]
    assert len(first) > COUNT
    assert set(first) == set(first_positions(DESIGN.first, True))
    assert abs(design.static_map().best() - 0.4) < 0.1


def test_positions_beside_the_best_go_further_out_where_nothing_differs():
    """Failed before: 48 holds, all within 6 % of the range."""
    rig = Simulated(lambda u: 0.0 if abs(u - 0.4) < 0.15 else 2.0)
    others = []  # of several knobs, what reacts is known from elsewhere
    for u in (0.0, 0.4):
        rig.go(u)
        others.append((Hold(u, 1, rig.stay(3000)), np.array([math.nan])))
    first = [0.37, 0.385, 0.415, 0.43]
    settings = replace(DESIGN, gap=0.2)
    design, moves = run(Design(RIG, (), None, settings, None, others, first), rig)
    assert design.ended == KNOWN
    assert len(moves) < 35
    valley = design.static_map().valley()
    assert (valley.low, valley.high) == pytest.approx((0.25, 0.55), abs=0.05)


def test_windows_that_come_back_to_their_length_lose_no_hold(monkeypatch):
    """Failed before: theta went over the range again and again, at the end of each hold."""
    rig, design = Simulated(lambda u: 3.0 * u), Design(RIG)
    design.look(rig.stay(round(DESIGN.shortest / DT)))
    length = design.windows.length

    class Reacts:
        """It looks slow through short windows and fast through long ones."""

        weight = 1.0

        def __init__(self, windows):
            self.factor = 2.0 if windows.length < 1.5 * length else 1.0

        def period(self, powers):
            return self.factor * length * DT / DESIGN.window

        def squares(self, powers):
            return powers.sum(axis=(1, 2))

        def log(self, squares):
            return 0.5 * np.log(squares)

    monkeypatch.setattr(
        "koop_tune.excitation.design.choose_amplitude", lambda windows, *_, **__: Reacts(windows)
    )
    for u, windows in ((0.0, 12), (0.5, 12), (1.0, DESIGN.brief + 1)):
        rig.go(u)
        design.holds.append(Hold(u, 1, rig.stay(windows * length)))
    design._queue = [0.75]
    design._choose()
    assert design.windows.length == pytest.approx(length, rel=0.1)
    assert (len(design.holds), design._queue) == (3, [0.75])


def test_a_map_that_errors_hide_is_looked_at_between_its_holds_and_loses_none():
    design, moves = excite(Simulated(absorber(0.5, 2.0, 0.5), noise=0.8, seed=2))
    assert len(design.holds) == len(moves) > COUNT
    assert 0.25 < design.static_map().best() < 0.75
    flat, _ = excite(Simulated(absorber(0.5, 2.0, 0.5), noise=0.8, seed=2), most=2 * COUNT - 1)
    for hold in flat.holds:  # all alike, and each known badly
        hold._parts, hold._level, hold._known = [flat.holds[0].x], None, None
    assert flat.static_map().flat
    assert flat._gap(0.5) is None
    move = flat.next()
    assert move.why == "again: errors hide the map"
    assert move.u in (0.0, 1.0)
    assert len(flat.holds) == 2 * COUNT - 1


def test_a_strong_slow_interference_neither_sets_the_windows_nor_hides_the_map(plain):
    (alone, _), (hidden, _) = plain, excite(Simulated(wide, interference=3.0, seed=3))
    assert hidden.period == pytest.approx(PERIOD, rel=0.25)
    assert hidden.windows.length < 1.5 * alone.windows.length
    assert abs(hidden.static_map().best() - 0.4) < 0.1
    ranges = [hidden.windows.frequency[[a, b]] for _, a, b in hidden.amplitude.ranges]
    assert not any(low <= 0.4 <= high for low, high in ranges)


def test_an_oscillation_too_slow_for_the_windows_counts_if_theta_makes_it():
    grows = Simulated(lambda u: 0.7 - 4.0 * u, slow=lambda u: max(u - 0.5, 0.0))
    design, moves = excite(grows, replace(RIG, time=3e4))
    assert any("what is slower reacts" in move.why for move in moves)
    assert design.ended == KNOWN
    assert design.amplitude.weight[:, np.abs(design.windows.frequency - SLOW) < 0.01].any()
    assert 0.55 < design.static_map().best() < 0.7  # where hypot(exp(0.7 - 4 u), u - 0.5) is least


def test_what_is_slower_counts_beside_a_stronger_line_that_does_not_react():
    """Failed before: only windows of which a hold has many were looked at, and those hid it."""
    rig = Simulated(lambda u: 0.7 - 4.0 * u, interference=3.0, slow=lambda u: max(u - 0.5, 0.0))
    rig.slow_frequency = 0.32
    settings = replace(DESIGN, fewest=40)  # of a rig that settles slowly
    design, moves = excite(rig, replace(RIG, time=6e4), settings=settings)
    assert any("what is slower reacts" in move.why for move in moves)
    assert design.ended == KNOWN
    assert 0.55 < design.static_map().best() < 0.7


@pytest.mark.parametrize("slow", [lambda u: 0.3, lambda u: 0.25 + 0.25 * u])
def test_what_is_slower_and_does_not_react_or_is_faint_needs_no_longer_windows(slow):
    rig = Simulated(wide, noise=0.5, slow=slow, seed=1)  # holds long enough to see it
    _, moves = excite(rig, replace(RIG, time=3e4))
    assert not any("what is slower reacts" in move.why for move in moves)


def test_windows_that_became_longer_do_so_once_until_theta_was_everywhere_again():
    """Failed before: a drift in the first two holds made them longer, and that in the next ones."""
    rig = Simulated(wide, slow=lambda u: 2.0 * u)
    design, _ = excite(rig, replace(RIG, time=3e4), most=COUNT)
    design._slow = True
    move = design._look_again(4 * design.windows.length, "what is slower reacts too")
    seconds = design.windows.seconds
    rig.slow_frequency, count = 3.0 / seconds, 0
    while design.windows.seconds == seconds:
        rig.go(move.u)
        design.arrive(move, rig.seconds)
        while not design.take(rig.stay(design.windows.length)):
            pass
        count, move = count + 1, design.next()
    assert count == COUNT


def test_a_slow_oscillation_far_from_the_best_sets_no_windows():
    """Failed before: windows of a limit cycle 100 times the best, ten times as long."""
    rig = Simulated(wide, slow=lambda u: 100.0 * (u > 0.75))
    rig.slow_frequency = 0.4
    design, _ = excite(rig, replace(RIG, time=3e4))
    assert design.ended == KNOWN
    assert design.windows.seconds < 20.0 * PERIOD
    assert abs(design.static_map().best() - 0.4) < 0.1


def test_a_coarse_sensor_may_read_one_value_in_the_whole_valley():
    """Failed before: an error of NumPy's, as what is near the best had no period."""
    rig = Simulated(lambda u: 1.0 if abs(u - 0.6) > 0.2 else -12.0)
    fine = rig.stay
    rig.stay = lambda samples: 0.1 * np.round(fine(samples) / 0.1)
    design, _ = excite(rig)
    assert design.ended == KNOWN
    assert abs(design.static_map().best() - 0.6) < 0.2
    valley = design.static_map().valley()
    assert (valley.low, valley.high) == pytest.approx((0.4, 0.8), abs=0.06)


def test_where_windows_become_longer_theta_goes_to_each_place_once():
    """Failed before: it went to the best as often as it had been there."""
    first, _ = excite(Simulated(wide), most=COUNT)
    brief = first.windows._replace(length=first.windows.length // 2)
    held = [hold.u for hold in first.holds]
    short = [Hold(h.u, 1, h.x[: DESIGN.brief * brief.length]) for h in first.holds[:-1]]
    design = Design(RIG, [*short, *short[3:5], first.holds[0]], brief)
    assert design.windows.length > brief.length
    assert [hold.u for hold in design.holds] == held[:1]
    assert sorted(design._queue) == sorted(held[1:])


@pytest.mark.parametrize(("flat", "ended"), [(25.0, KNOWN), (1e9, TIME)])
def test_once_more_holds_would_not_help_a_map_that_shows_anything_is_known(
    flat, ended, monkeypatch
):
    monkeypatch.setattr(static_map, "MAP", replace(static_map.MAP, flat=flat))
    settings = replace(DESIGN, most=COUNT + 1)
    assert excite(Simulated(lambda u: -0.5 * u), settings=settings)[0].ended == ended


def test_a_narrow_valley_that_is_seen_on_the_way_back_is_no_lag():
    design, moves = excite(Simulated(absorber(0.1, 15.0, 0.1)))
    assert design.since == 0.0
    assert [move.u for move in moves[:COUNT]] == first_positions(DESIGN.first, True)
    assert moves[COUNT].u not in (0.0, 1.0)


def test_a_hold_that_only_looks_into_a_gap_need_not_be_as_sure():
    def looks(error_of_gap):
        rig = Simulated(lambda u: 0.6 * wide(u), noise=0.4, seed=2)
        design, _ = excite(rig, settings=replace(DESIGN, error_of_gap=error_of_gap))
        return np.mean([hold.size for hold in design.holds if hold.why == GAP])

    assert looks(DESIGN.error_of_gap) < 0.6 * looks(0.0)


def test_hysteresis_is_visited_from_both_sides_and_told_as_doubt():
    def sides(u, side):  # what comes from above oscillates more
        return 0.4 * (side < 0)

    plain, torn = (excite(Simulated(wide, noise=0.02, sides=s))[0] for s in (None, sides))
    best = torn.static_map().best()
    same = DESIGN.same * torn.static_map().valley().width
    near = [hold for hold in torn.holds if abs(hold.u - best) <= max(same, DESIGN.finest)]
    assert {hold.side for hold in near} == {1, -1}
    at = [m.deviation[round(m.best() * 1024)] for m in (plain.static_map(), torn.static_map())]
    assert at[1] > 2.0 * at[0]


def test_theta_rests_until_a_slow_rig_has_settled():
    def shallow(u):
        return 1.2 * (u - 0.4) ** 2

    design, _ = excite(Simulated(shallow, noise=0.01, tau=10.0), replace(RIG, time=3e4))
    levels = design.levels()
    off = np.array([x.mean - shallow(hold.u) for x, hold in zip(levels, design.holds, strict=True)])
    assert np.abs(off - np.median(off)).max() < 0.08


def test_the_best_is_held_as_long_as_the_rig_was_seen_to_need_to_grow():
    def slow(u):
        return absorber(0.05, 6.0, 0.45)(u)

    design, _ = excite(Simulated(slow, noise=0.03, tau=25.0), replace(RIG, time=3e4))
    growth = max(x.skip for x in design.levels() if x.rise > HOLDS.grown)
    confirmed = [hold for hold in design.holds if hold.confirms]
    assert confirmed
    for hold in confirmed:
        assert hold.size / design.windows.length >= DESIGN.growth * growth


def test_too_short_a_time_is_known_before_theta_moves():
    design = Design(RIG)
    rig = Simulated(wide)
    design.look(rig.stay(2000))
    # the first positions, and the range there and back; a look into each gap, the best twice
    least = COUNT * DESIGN.fewest * design.windows.seconds + 2.0 * 4.0 / RIG.theta_rate
    after = (10 * DESIGN.brief + 2 * DESIGN.fewest) * design.windows.seconds
    assert design.needed == pytest.approx((least, least + after))
    done, all_of_it = Simulated(wide), design.needed[1]
    last, _ = excite(done)
    assert all_of_it < done.seconds
    first, hold = last.needed  # once the map is known
    assert first == 0.0 < hold < 0.1 * done.seconds
    _, moves = excite(Simulated(wide), most=COUNT)
    assert len(moves) == COUNT
    began = Simulated(wide)
    first = excite(began, most=COUNT)[0]
    assert began.seconds > 0.5 * first.needed[0]  # what was said was not far too much
    slow = replace(RIG, theta_rate=0.001)
    crawls = Design(slow)
    crawls.look(Simulated(wide).stay(2000))
    assert crawls.needed[0] > 8000.0


def test_a_hold_takes_no_more_than_its_share_of_the_time_that_is_left():
    file = replace(RIG, time=1200.0)
    design, moves = excite(Simulated(wide, noise=0.5), file, most=12)
    longest = max(h.size for h in design.holds) * DT
    assert longest <= max(DESIGN.most_share * 1200.0, DESIGN.fewest * design.windows.seconds) + 1.0
    assert len(moves) == 12


@pytest.mark.parametrize("done", [1, 12])
def test_an_excitation_resumes_from_its_holds(done):
    first, _ = excite(Simulated(wide), most=done)
    kept = [Hold(h.u, h.side, h.x) for h in first.holds]
    resumed, moves = excite(Simulated(wide, seed=1), holds=kept)
    assert resumed.ended == KNOWN
    assert [hold.u for hold in resumed.holds[:done]] == [hold.u for hold in first.holds]
    remaining = first_positions(DESIGN.first, True)[done:]
    assert [move.u for move in moves[: len(remaining)]] == remaining
    assert abs(resumed.static_map().best() - 0.4) < 0.1


def test_an_excitation_goes_on_in_the_other_direction_without_missing_a_position():
    first, _ = excite(Simulated(wide), most=3)
    above = replace(RIG, theta_start=3.0)  # another theta_start does not begin another excitation
    _, moves = excite(Simulated(wide, seed=1), above, holds=first.holds, most=COUNT - 3)
    visited = {h.u for h in first.holds} | {move.u for move in moves}
    assert visited >= set(first_positions(DESIGN.first, True))


def test_channels_that_do_not_move_are_refused():
    with pytest.raises(InputError, match="no channel moves"):
        Design(RIG).look(np.ones((1000, 1)))


def test_a_move_may_pass_another_position():
    assert Move(0.5) == Move(0.5, None)
    assert first_positions(3, False) == [1.0, 0.5, 0.0, 0.25, 0.75]
