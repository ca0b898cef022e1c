"""Theta keeps limits and rate whatever comes in; a trip is latched until a rearm."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from koop_core.config.parameter import ConfigError
from koop_guard.config import SAFETY, GuardConfig
from koop_guard.guard import Cause, Guard, RepeatMeter, Status
from koop_guard.node.twin import LOOK, Stillness

DT = 0.005
CONFIG = GuardConfig(
    measured="/rig:x,y", command="/rig/theta:data", dt=DT, theta_min=-1.0, theta_max=2.0,
    theta_rate=4.0, theta_start=1.5, theta_safe=0.5, channel_min=(-3.0, -9.0),
    channel_max=(3.0, 9.0),
)  # fmt: skip
CONFIG_2 = replace(
    CONFIG, command="/rig/gains:kp,kd", theta_min=(-1.0, 0.0), theta_max=(2.0, 0.1),
    theta_rate=(4.0, 0.01), theta_start=(1.5, 0.1), theta_safe=(0.5, 0.02),
)  # fmt: skip
CONFIG_3 = replace(CONFIG_2, constraint="30 kd >= kp; kp + 30 kd <= 5.5 - 0.5 theta[0]")
LINES = {CONFIG_3: (np.array([[1.0, -30.0], [1.5, 30.0]]), np.array([0.0, 5.5]))}
CONFIG_1 = GuardConfig(measured="/rig:x", command="/rig/theta:data", dt=DT)
SILENCE = SAFETY.silence(DT)
CALM = SAFETY.calm


class Loop:
    """A guard with its clock, a rig and a controller; each may fail."""

    def __init__(self, config=CONFIG, theta=1.5):
        self.guard, self.now, self.k = Guard(config, [theta]), 100.0, 0
        self.thetas = [theta]

    def run(self, seconds, x=lambda k: math.sin(0.3 * k), asked=1.0, saturated=False, old=False):
        """Let time pass; with ``x`` None the rig is silent, with ``asked`` None the controller."""
        for _ in range(round(seconds / DT)):
            self.now += DT
            self.k += 1
            if x is not None:
                self.guard.hear_state((x(self.k), math.cos(0.3 * self.k)), self.now)
            if asked is not None and x is not None:
                self.guard.hear_answer([asked], saturated, self.now, old)
            self.guard.hear_time(self.now)
            self.thetas += self.guard.advance(self.now)
        return self.guard


WILD = st.one_of(
    st.floats(), st.floats(-5.0, 5.0), st.sampled_from([math.nan, math.inf, -math.inf, 1e308])
)
EVENT = st.tuples(
    st.sampled_from(["state", "answer", "old", "tick", "trip", "rearm"]), WILD, WILD,
    st.sampled_from([0.0, 1e-9, 0.001, DT, 0.02, 0.3, 5.0, 1e6]),
)  # fmt: skip


@pytest.mark.parametrize("config", [CONFIG, CONFIG_2, CONFIG_3])
@settings(deadline=None, max_examples=300)
@given(share=st.floats(0.0, 1.0), events=st.lists(EVENT, max_size=60))
def test_theta_keeps_its_limits_and_its_rate_whatever_comes_in(config, share, events):
    low, high, rate = (np.array(config.each(f"theta_{name}")) for name in ("min", "max", "rate"))
    lines, bounds = LINES.get(config, (np.zeros((0, config.count)), np.zeros(0)))
    guard, now, moved = Guard(config, (low + share * (high - low)).tolist()), 10.0, math.inf
    last = np.array(guard.theta)
    for what, a, b, wait in events:
        now += wait
        if what == "state":
            guard.hear_state((a, b), now)
        elif what in ("answer", "old"):
            guard.hear_answer((a, 0.1 * b)[: config.count], b > 0.0, now, what == "old")
        elif what == "tick":
            guard.hear_time(now)
        elif what == "trip":
            guard.note(Cause.ASKED, "x", now)
        elif not guard.refusal(now):
            guard.rearm(now, True)
        new = np.array(guard.advance(now))
        assert np.all((low <= new) & (new <= high))
        assert np.all(lines @ new <= bounds)
        # 1e-15: a sum of two doubles of this size is rounded by that much
        most = rate * min(max(now - moved, 0.0), 2.0 * SAFETY.tick) * (1 + 1e-9) + 1e-15
        assert np.all(np.abs(new - last) <= most)
        way, left = new - last, np.array(guard.target) - last
        assert np.ptp(way * left[::-1]) <= 1e-14  # in a straight line
        last, moved = new, now


@settings(deadline=None)
@given(st.integers(0, 2**32), st.integers(2, 4), st.integers(1, 4))
def test_theta_keeps_any_lines_between_knobs_and_moves_as_far_as_they_let_it(seed, n, m):
    rng = np.random.default_rng(seed)
    span, safe = 10.0 ** rng.uniform(-3.0, 3.0, n), rng.uniform(-0.9, 0.9, n)
    a = rng.standard_normal((m, n)) / span
    b = a @ (safe * span) + rng.uniform(0.01, 1.0, m)
    text = [" ".join(f"{w:+.17g} theta[{i}]" for i, w in enumerate(row)) for row in a]
    config = replace(
        CONFIG, command="/r/t:" + ",".join("abcd"[:n]), theta_min=tuple(-span),
        theta_max=tuple(span), theta_rate=tuple(span), theta_safe=tuple(safe * span),
        theta_start=tuple(safe * span),
        constraint="; ".join(f"{row} <= {v:.17g}" for row, v in zip(text, b, strict=True)),
    )  # fmt: skip
    guard = Guard(config, config.theta_safe)
    for _ in range(20):
        asked = span * rng.uniform(-2.0, 2.0, n)
        guard.go(asked)
        target, clipped = np.array(guard.target), np.clip(asked, -span, span)
        assert config.limit(guard.target) == guard.target
        assert np.ptp((target - safe * span) / (clipped - safe * span)) < 1e-9  # straight
        at_line = np.isclose(a @ target, b, atol=1e-9).any()
        assert at_line or (target == clipped).all()
        for _ in range(int(rng.integers(1, 40))):
            before, theta = np.array(guard.theta), np.array(guard.move(DT))
            assert (a @ theta <= b).all()
            assert (np.abs(theta) <= span).all()
            assert (np.abs(theta - before) <= span * DT * (1.0 + 1e-9)).all()


@given(st.lists(EVENT, max_size=60))
def test_only_a_rearm_lets_the_controller_command_again(events):
    guard, now = Guard(CONFIG, [1.5]), 10.0
    guard.note(Cause.ASKED, "x", now)
    for what, a, b, wait in events:
        now += wait
        if what == "state":
            guard.hear_state((a, b), now)
        elif what in ("answer", "old"):
            guard.hear_answer([a], b > 0.0, now, what == "old")
        guard.hear_time(now)
        guard.advance(now)
        assert guard.status is Status.TRIPPED
        assert guard.trip.cause is Cause.ASKED  # the first cause stays
        assert guard.target == (CONFIG.theta_safe,)


@pytest.mark.parametrize(
    ("fault", "seconds", "cause", "reason"),
    [
        ({"x": lambda k: 3.5}, DT, Cause.BEYOND, "x = 3.5 is beyond its limit 3"),
        ({"x": lambda k: -3.5}, DT, Cause.BEYOND, "x = -3.5 is beyond its limit -3"),
        ({"x": lambda k: math.nan}, DT, Cause.NOT_FINITE, "x on /rig is not a finite number"),
        ({"x": lambda k: math.inf}, DT, Cause.NOT_FINITE, "x on /rig is not a finite number"),
        ({"x": lambda k: 0.25}, SILENCE, Cause.STUCK, "x = 0.25 has not changed for 2"),
        ({"x": None}, SILENCE, Cause.RIG_SILENT, "no message on /rig for 1.0 s"),
        ({"asked": None}, SILENCE, Cause.SILENT, "the controller is silent for 1.0 s"),
        ({"asked": math.nan}, SILENCE, Cause.SILENT, "the controller is silent for 1.0 s"),
        ({"old": True}, SILENCE, Cause.TOO_OLD, "the controller's answers are older than 1.0 s"),
    ],
)
def test_what_fails_trips_the_guard_in_time_and_theta_returns(fault, seconds, cause, reason):
    loop = Loop()
    assert loop.run(10.0).status is Status.FOLLOWING
    before = loop.now
    guard = loop.run(seconds + 0.05, **fault)
    assert (guard.status, guard.trip.cause) == (Status.TRIPPED, cause)
    assert reason in guard.trip.reason
    assert guard.trip.theta == (1.0,)
    # in time: not before it can be known, and no more than two samples after
    assert seconds - 1e-9 <= guard.trip.when - before + DT <= seconds + 3 * DT
    loop.run(0.5 / CONFIG.theta_rate + 2 * DT, **fault)
    assert guard.at_safe
    assert guard.theta == (CONFIG.theta_safe,)
    assert max(abs(b - a) for a, b in pairwise(loop.thetas)) <= CONFIG.theta_rate * DT * (1 + 1e-6)


@pytest.mark.parametrize("queued", ["nothing", "states", "old answers"])
def test_a_guard_that_stood_still_says_so_and_not_that_others_were_silent(queued):
    """Failed before: its trip read that the rig or the controller had been silent meanwhile."""
    loop = Loop()
    loop.run(2.0)
    loop.now += 6.4
    if queued != "nothing":  # was in the queue and is heard before it looks
        loop.guard.hear_state((0.1, 0.2), loop.now)
    if queued == "old answers":
        loop.guard.hear_answer([1.0], False, loop.now, True)
    loop.guard.hear_time(loop.now)
    loop.guard.advance(loop.now)
    told = "the guard itself stood still for 6.4 s"
    assert (loop.guard.trip.cause, loop.guard.trip.reason) == (Cause.STILL, told)
    loop.run(CALM - 0.1)
    assert loop.guard.refusal(loop.now) == told
    assert loop.run(0.2).refusal(loop.now) == ""
    loop.guard.rearm(loop.now, True)
    assert loop.run(10.0).trip.cause is Cause.STILL
    loop.run(SILENCE + 0.1, x=None)  # a silence is one still
    assert loop.guard.trip.cause is Cause.RIG_SILENT


def test_nothing_is_commanded_before_the_controller_answers_and_short_gaps_do_no_harm():
    loop = Loop()
    assert loop.run(5.0, asked=None).status is Status.WAITING
    assert set(loop.thetas) == {1.5}
    loop.run(1.0)
    for fault in ({"x": None}, {"asked": None}, {"old": True}):
        loop.run(0.9 * SILENCE, **fault)
        assert loop.run(0.5).status is Status.FOLLOWING
        assert loop.guard.theta == (1.0,)


def test_a_controller_at_its_limit_is_allowed_for_a_time():
    config = GuardConfig(measured="/r:x,y", command="/r/t:data", dt=DT, at_limit=3.0)
    loop = Loop(config, 0.0)
    assert loop.run(2.9, saturated=True).status is Status.FOLLOWING
    loop.run(0.1)
    assert loop.run(2.9, saturated=True).status is Status.FOLLOWING
    assert loop.run(0.2, saturated=True).trip.cause is Cause.AT_LIMIT


@pytest.mark.parametrize(
    ("command", "names"),
    [
        ("/r/gains:kp,kd", ("kp", "kd")),
        ("/a/t:kp,/b/t:kd", ("kp", "kd")),
        ("/r/kp:data, /r/kd:data", ("kp", "kd")),
        ("/a/t:data,/b/t:data", ("/a/t:data", "/b/t:data")),
    ],
)
def test_the_knob_at_its_limit_is_named(command, names):
    guard = Guard(replace(CONFIG_2, command=command, at_limit=3.0), (1.0, 0.1))
    for k in range(700):
        guard.hear_answer((1.0 + 1e-4 * k, 0.1), True, k * DT)
        guard.advance(k * DT)
    assert guard.trip.reason == f"the controller is at {names[1]} = 0.1, its limit, for 3 s"
    assert guard.trip.theta == pytest.approx((1.06, 0.1), abs=1e-3)
    for k in range(700, 4000):
        guard.advance(k * DT)
        # both arrive together: the slower one needs 8 s
        assert guard.at_safe is (guard.theta[0] == 0.5) is (guard.theta[1] == 0.02)
    assert guard.at_safe


def test_a_constraint_may_be_broken_for_three_windows():
    config = GuardConfig(
        measured="/r:x,y", command="/r/t:data", dt=DT, constraint="rms(/r/effort:data, 2 s) < 3"
    )
    loop = Loop(config, 0.0)

    def run(seconds, margin):
        for _ in range(round(seconds / DT)):
            loop.guard.hear_margin(margin, loop.now)
            loop.run(DT)
        return loop.guard

    assert run(20.0, math.nan).status is Status.FOLLOWING  # the signal was never heard
    assert run(20.0, 0.1).status is Status.FOLLOWING
    for margin, words in ((-0.2, "its margin is -0.2"), (math.nan, "its signal is not known")):
        assert run(5.8, margin).status is Status.FOLLOWING
        guard = run(0.4, margin)
        assert (guard.status, guard.trip.cause) == (Status.TRIPPED, Cause.BROKEN)
        reason = guard.trip.reason
        assert reason.startswith("the constraint rms(/r/effort:data, 2 s) < 3 is not kept")
        assert reason.endswith(words)
        assert "is not kept" in run(1.0, margin).refusal(loop.now)  # while it lasts
        run(CALM + 0.1, 0.1)
        assert guard.refusal(loop.now) == ""
        guard.rearm(loop.now, True)
        assert run(20.0, 0.1).status is Status.FOLLOWING


def test_a_constraint_that_was_kept_and_of_which_nothing_new_comes_is_not_called_broken():
    """Failed before: 'is not kept for 6.0 s: its margin is 0.22'."""
    bound = "rms(/r/effort:data, 2 s) < 3"
    config = GuardConfig(measured="/r:x,y", command="/r/t:data", dt=DT, constraint=bound)
    loop = Loop(config, 0.0)
    loop.guard.hear_margin(0.22, loop.now)
    assert loop.run(5.9).status is Status.FOLLOWING
    trip = loop.run(0.2).trip
    assert (trip.cause, trip.reason) == (
        Cause.BROKEN,
        f"nothing new of the constraint {bound} for 6.0 s",
    )


def test_a_rearm_is_refused_while_the_cause_lasts_and_theta_goes_on_from_theta_safe():
    loop = Loop()
    loop.run(1.0)
    guard = loop.run(DT, x=lambda k: 5.0)
    guard.note(Cause.OTHER, "/r/t is also commanded by /x", loop.now)
    all_that_lasts = "x = 5 is beyond its limit 3; /r/t is also commanded by /x"
    assert guard.refusal(loop.now) == all_that_lasts
    loop.run(CALM - 0.1)
    assert guard.refusal(loop.now) == all_that_lasts
    loop.run(0.2)
    assert guard.refusal(loop.now) == ""
    guard.rearm(loop.now, True)
    assert guard.refusal(loop.now) == "the guard has not tripped"
    loop.thetas.clear()
    assert loop.run(2.0).theta == (1.0,)
    assert abs(loop.thetas[0] - CONFIG.theta_safe) <= CONFIG.theta_rate * DT * (1 + 1e-6)


def test_a_guard_that_was_told_to_trip_may_be_rearmed_once_theta_is_back():
    loop = Loop()
    loop.run(1.0)
    loop.guard.note(Cause.ASKED, "asked", loop.now)
    assert "still returns to theta_safe" in loop.guard.refusal(loop.now)
    loop.run(0.2)
    assert loop.guard.refusal(loop.now) == ""


def test_automatic_rearms_are_counted_and_their_pause_doubles():
    config = GuardConfig(
        measured="/r:x,y", command="/r/t:data", dt=DT, rearms=2,
        channel_max=(3.0, 9.0),
    )  # fmt: skip
    loop = Loop(config, 0.0)
    loop.run(1.0)
    for pause in (10.0, 20.0):
        guard = loop.run(DT, x=lambda k: 5.0)
        quiet = 0.0
        assert (guard.pause, guard.rearms_at) == (pause, math.inf)  # the cause lasts
        due = loop.run(CALM + 0.1).rearms_at
        quiet += CALM + 0.1
        assert due - loop.now == pytest.approx(pause - 0.1, abs=2 * DT)
        while not guard.may_rearm_itself(loop.now):
            loop.run(0.1)
            quiet += 0.1
        assert pause + CALM - 0.2 < quiet < pause + CALM + 0.4
        guard.rearm(loop.now, False)
        loop.run(1.0)
    loop.run(DT, x=lambda k: 5.0)
    loop.run(100.0)
    assert not loop.guard.may_rearm_itself(loop.now)
    assert math.isinf(loop.guard.pause)
    assert loop.guard.refusal(loop.now) == ""  # by hand it may be
    asked = Loop(config, 0.0)
    asked.run(1.0)
    asked.guard.note(Cause.ASKED, "asked", asked.now)
    asked.run(30.0)
    assert not asked.guard.may_rearm_itself(asked.now)


def test_how_long_a_channel_may_repeat_follows_from_how_often_it_does():
    rng = np.random.default_rng(0)
    for resolution, low, high in ((1e-9, 3.0, 6.0), (0.2, 8.0, 20.0)):
        meter, longest = RepeatMeter(), 0
        for value in np.round(rng.normal(size=20_000) / resolution) * resolution:
            meter.hear(value)
            longest = max(longest, meter.run)
            assert meter.run <= meter.longest
        # the chance that two samples round alike is 0 and about 0.2 / (2 sqrt(pi)) = 0.056; the
        # share of the last 25 samples may be twice that
        assert low <= meter.longest <= high


def trips(values):
    """Return whether a channel of a rig with these values, in steps, is found stuck."""
    guard = Guard(CONFIG_1, [0.0])
    for k, value in enumerate(np.round(values).tolist()):
        guard.hear_state((value,), k * DT)
        if guard.status is Status.TRIPPED:
            assert guard.trip.cause is Cause.STUCK
            return True
    return False


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.2, 0.3])
@pytest.mark.parametrize(
    ("period", "fade"), [(10, 3.0), (23.7, 3.0), (100, 3.0), (400, 3.0), (10, 30.0), (100, 30.0)]
)
def test_an_oscillation_that_dies_away_below_the_resolution_is_not_stuck(noise, period, fade):
    """Failed before: what fell from 100 steps within 1000 samples was stuck at rest."""
    rng = np.random.default_rng(int(1e3 * noise + period))
    for size in (2.0, 30.0, 1000.0):
        k = np.arange(3000 + round(fade * period * math.log(size / 0.3)) + 1000)
        amplitude = size * np.exp(-np.maximum(k - 3000, 0) / (fade * period))
        x = amplitude * np.sin(2.0 * np.pi * k / period) + rng.uniform(-0.5, 0.5)
        assert not trips(x + noise * rng.normal(size=k.size))


@pytest.mark.parametrize(
    ("size", "noise", "found"),
    [
        (0.0, 0.7, True),  # noise alone moves it: it cannot rest
        (1.0, 0.7, True),
        (3.0, 1.0, True),
        (30.0, 0.0, True),  # it cannot have come to rest at once
        (30.0, 0.3, True),
        (1.0, 0.0, False),  # these two may have died away
        (2.0, 0.2, False),
    ],
)
def test_a_channel_is_stuck_if_neither_chance_nor_rest_explains_that_it_is_still(
    size, noise, found
):
    """Failed before: what had moved by less than 3 steps was never stuck, however noisy."""
    rng = np.random.default_rng(3)
    for period in (10.3, 25.0, 60.0):
        k = np.arange(5000)
        x = size * np.sin(2.0 * np.pi * k / period) + 0.2 + noise * rng.normal(size=k.size)
        assert not trips(x)
        assert trips(np.append(x, np.full(3000, x[-1]))) is found


BAD = (
    ("kp < 20 kd", "^constraint = 'kp < 20 kd': write kp <= 20 kd between knobs, or rms"),
    ("kp <= 20 kx", "^constraint = .*: unknown knob 'kx': known are kp, kd"),
    ("kp * kd <= 2", r"^constraint = .*: '\* kd' is not a sum of knobs, each with a factor"),
    ("kp <= 2; kp <= kd", "^constraint = .*: kp <= 2 is not between two knobs: theta_min and"),
    ("kp + kd >= 1", r"^theta_safe = \[0.5, 0.5\]: must lie within kp \+ kd >= 1, a constraint"),
    ("kp + 2 kd <= 4", r"^theta_start = \[1.5, 1.5\]: must lie within kp \+ 2 kd <= 4"),
)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"command": ""}, "command is missing"),
        ({"command": "/r/t:a,/rig:z"}, "is the topic of the measured channels"),
        ({"command": "/r/t:a,/r/t:b"}, "names a topic twice"),
        ({"command": "/r/t:" + ",".join("abcdefghi")}, "names more than 8 knobs"),
        ({"theta_safe": (0.5, 0.5)}, "theta_safe has 2 values: the command has 1 field$"),
        ({"command": "/r/t:a,b", "theta_max": (2.0, 1.2)}, "theta_start = 1.5 of b: must lie"),
        ({"command": "/rig:z"}, "is the topic of the measured channels"),
        ({"theta_min": 3.0}, "must be below theta_max"),
        ({"theta_safe": 5.0}, "theta_safe = 5: must lie within"),
        ({"channel_max": (1.0,)}, "channel_max has 1 values: one for each of 2 channels"),
        ({"on_end": "stay"}, "must be one of safe, hold"),
        *(({"command": "/r/t:kp,kd", "constraint": text}, reason) for text, reason in BAD),
    ],
)
def test_what_contradicts_itself_is_refused(values, reason):
    given = {name: getattr(CONFIG, name) for name in CONFIG.__dataclass_fields__} | values
    with pytest.raises(ConfigError, match=reason):
        GuardConfig(**given)


def test_a_theta_that_is_sent_by_hand_waits_for_no_controller():
    guard, now = Guard(CONFIG, [1.5]), 10.0
    guard.go([9.0])
    for _ in range(1000):
        now += DT
        guard.hear_state((math.sin(now), math.cos(now)), now)
        guard.hear_time(now)
        guard.move(DT)
    assert (guard.theta, guard.arrived, guard.trip) == ((CONFIG.theta_max,), True, None)
    guard.follow(now + 1.0)  # a controller has a second to begin, then its silence counts
    for _ in range(round((1.0 + SILENCE) / DT) + 1):
        assert guard.trip is None
        now += DT
        guard.hear_state((math.sin(now), math.cos(now)), now)
        guard.hear_time(now)
    assert guard.trip.cause is Cause.SILENT
    guard.go([0.0])
    assert guard.target == (CONFIG.theta_safe,)


def test_times_follow_the_pace_of_the_rig():
    fast = replace(CONFIG, pace=4.0, dt=0.5)
    assert CONFIG.return_time([2.0]) == pytest.approx(1.5 / 4.0)
    assert fast.return_time([2.0]) == pytest.approx(1.5 / 16.0)
    assert SAFETY.silence(CONFIG.period) == 1.0  # a busy machine needs that
    assert SAFETY.silence(fast.period) == pytest.approx(2.5)
    guard = Guard(replace(fast, dt=0.1), [2.0])
    guard.go([-1.0])
    assert guard.move(0.01) == pytest.approx((2.0 - 0.16,))
    assert guard.move(1e9) == pytest.approx(
        (2.0 - 0.16 - 16.0 * 0.05,)
    )  # two periods, however late


def test_the_twin_counts_only_the_time_in_which_it_looked():
    still = Stillness()
    assert still.look(alive=1.0, commanded=True) == 0.0
    assert [still.look(1.0, True) for _ in range(3)] == [LOOK, 2 * LOOK, 3 * LOOK]  # a pause: none
    assert still.look(1000.0, True) == 0.0
    assert [still.look(1000.0, False) for _ in range(3)] == [0.0] * 3  # nothing is commanded
