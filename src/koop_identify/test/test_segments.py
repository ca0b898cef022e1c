"""Samples of a bag are counted and cut into segments, however they are read."""

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from koop_core.stream.arrival import NOTHING, classify
from koop_identify.model.from_bags import join_parts
from koop_identify.recording import counted
from koop_identify.recording.passes import keys
from koop_identify.recording.samples import Batch
from koop_identify.recording.segments import Segmentation, Segmenter

DT = 0.02


@settings(deadline=None, max_examples=200)
@given(st.one_of(st.sets(st.integers(0, 40)).map(sorted), st.lists(st.integers(0, 9))))
def test_messages_of_a_recording_are_what_they_were_to_a_node(steps):
    heard, expected = NOTHING, []
    for step in steps:
        arrival, heard = classify(heard, step, 0.0, DT)
        expected.append(arrival)
    assert keys(np.array(steps, np.int64))[0].tolist() == expected


@settings(deadline=None, max_examples=60)
@given(st.data())
def test_how_a_stream_is_batched_does_not_matter_to_the_count(data):
    size = data.draw(st.integers(2, 80))
    seed = data.draw(st.integers(0, 99))
    rng = np.random.default_rng(seed)
    lost = rng.random(size) < 0.05
    t = (np.cumsum(1.0 + 5.0 * lost) * DT * 1e9).astype(np.int64)
    t += (rng.exponential(size=size) * DT * 1e9).astype(np.int64)
    edges = [0, *sorted(data.draw(st.sets(st.integers(1, size - 1), max_size=6))), size]
    parts = [Batch(t[a:b], None, t[a:b, None] + 0.0, False) for a, b in pairwise(edges)]
    whole = [Batch(t, None, t[:, None] + 0.0, False)]
    times = [
        np.concatenate([part.time for part in counted.recount(fed, DT * 1e9, DT * 1e9, 5, 10)])
        for fed in (parts, whole)
    ]
    assert times[0].tolist() == times[1].tolist()


def test_a_clock_that_is_set_back_ends_a_segment():
    t = np.arange(100) * 10_000_000
    t[50:] -= 10**9
    (batch,) = counted.recount([Batch(t, None, t[:, None] + 0.0, False)], 1e7, 1e7)
    assert np.flatnonzero(np.diff(batch.time) != 10_000_000).tolist() == [49]
    assert np.diff(batch.time)[49] < 0


def split(segmentation, time, step, x, bounds, apart):
    """Feed samples in batches; return all pairs of states so many steps apart."""
    segmenter = Segmenter(segmentation)
    edges = [0, *sorted(bounds), time.size]
    parts = [slice(a, b) for a, b in pairwise(edges)]
    fed = (Batch(time[p], step[p], x[p]) for p in parts)
    parts = list(join_parts((part for batch in fed for part in segmenter.split(batch)), apart))
    return [
        (*states[:, k - apart], *states[:, k])
        for states in parts
        for k in range(apart, states.shape[1])
    ]


@settings(deadline=None, max_examples=60)
@given(st.data())
def test_how_a_bag_is_read_in_batches_does_not_matter(data):
    size = data.draw(st.integers(5, 60))
    jumps = data.draw(st.lists(st.sampled_from([1, 1, 1, 1, 2, 9, 0, -5]), min_size=size,
                               max_size=size))  # fmt: skip
    step = np.cumsum(jumps)
    time = np.cumsum(np.array(jumps) * 10_000_000 + data.draw(st.integers(-3000, 3000)))
    x = np.arange(float(size))[:, None] ** [1, 2]
    x[data.draw(st.lists(st.integers(0, size - 1), max_size=2)), 0] = np.nan
    way = data.draw(st.sampled_from(["steps", "linear"]))
    segmentation = Segmentation(way, 0.007 if way == "linear" else 0.01, 0.035)
    bounds = data.draw(st.sets(st.integers(1, size - 1), max_size=6))
    for apart in (1, 3):
        whole = split(segmentation, time, step, x, set(), apart)
        assert split(segmentation, time, step, x, bounds, apart) == whole


def test_steps_pair_only_neighbours_of_the_same_run_and_share():
    step = np.array([0, 1, 2, 4, 5, 5, 6, 0, 1, 2])
    x = np.array([10.0, 11, 12, 14, 15, 15, np.nan, 20, 21, 22])[:, None]
    segmentation = Segmentation("steps", 0.01, 0.01)
    pairs = split(segmentation, step * 10_000_000, step, x, {3}, 1)
    assert pairs == [(10, 11), (11, 12), (14, 15), (20, 21), (21, 22)]
    assert split(segmentation, step * 10_000_000, step, x, {3}, 3) == []


def test_missing_steps_are_bridged_where_that_is_asked_for():
    step = np.delete(np.arange(40), [3, 10, 11, 20, 21, 22])
    x = np.column_stack([np.sin(0.1 * step), step])
    segmenter = Segmenter(Segmentation("steps", 0.01, 0.03))  # two missing ones, not three
    parts = [slice(0, 3), slice(3, 9), slice(9, None)]
    fed = [Batch(step[p] * 10_000_000, step[p], x[p]) for p in parts]
    found = [part for batch in fed for part in segmenter.split(batch)]
    states = np.hstack([part.states for part in found])
    assert states[1].tolist() == [*range(20), *range(23, 40)]
    assert [part.states[1, 0] for part in found if part.begins] == [0.0, 23.0]
    there = np.isin(states[1], step)
    assert states[0][there].tolist() == x[:, 0].tolist()  # to the bit
    # a straight line over 0.03 s: h^2 |x''| / 8
    assert np.abs(states[0] - np.sin(0.1 * states[1])).max() <= 0.3**2 / 8.0
