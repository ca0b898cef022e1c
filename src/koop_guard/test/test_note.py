"""What is known of a rig before a command."""

import json
import math
import threading
from dataclasses import replace

import pytest

from koop_core.config.parameter import ConfigError
from koop_guard.config import GuardConfig
from koop_guard.guard import Cause, Trip
from koop_guard.note import Keeper, Note, find_theta, leave, read

RIG = GuardConfig(
    measured="/a:x,y", command="/b:z", theta_min=-1.0, theta_max=3.0, theta_start=2.0,
    theta_safe=0.5,
)  # fmt: skip
LEFT = Note((0.75,), "/b:z", ("a", "b"), None, 0)
TRIP = Trip(Cause.NOT_FINITE, "x on /a is not a finite number", 1e9, (0.7,), (math.inf, 0.25))


def test_theta_is_where_it_was_left_unless_the_rig_was_restarted(tmp_path):
    note = tmp_path / "note"
    assert find_theta(None, RIG, ["a"]) == ((RIG.theta_start,), "")
    assert find_theta(note, RIG, ["a"]) == ((RIG.theta_start,), "")
    leave(note, LEFT)
    assert find_theta(note, RIG, ["b"]) == ((0.75,), "")
    assert find_theta(note, RIG, []) == ((0.75,), "")  # not discovered yet
    theta, remark = find_theta(note, RIG, ["c"])
    assert theta == (RIG.theta_start,)
    assert "restarted since theta was left at 0.75: assuming theta_start = 2" in remark
    leave(note, replace(LEFT, theta=(9.0,)))  # beyond the limits
    assert find_theta(note, RIG, ["a"]) == ((RIG.theta_start,), "")
    theta, remark = find_theta(note, replace(RIG, command="/c:z"), ["a"])
    assert (theta, remark) == ((RIG.theta_start,), f"{note} is of /b:z: assuming theta_start = 2")


def test_a_trip_is_noted_and_a_damaged_note_is_refused(tmp_path):
    note = tmp_path / "note"
    left = replace(LEFT, trip=TRIP, rearmed=2)
    leave(note, left)
    assert read(note) == left
    whole = note.read_text()
    values = json.loads(whole)
    less = {name: value for name, value in values.items() if name != "trip"}
    for torn in (whole[:-9], "abc", "[1]", *map(json.dumps, ({**values, "trip": {}}, less))):
        note.write_text(torn)
        with pytest.raises(ConfigError, match=r"note: (is damaged|cannot be read).*delete"):
            read(note)
    leave(tmp_path / "no" / "note", left)  # is no fault


def test_on_a_full_disk_a_note_takes_the_room_of_the_old_one_or_says_why_it_is_not_written(
    tmp_path,
):
    note = tmp_path / "note"
    assert leave(note, replace(LEFT, trip=TRIP)) == ""
    (tmp_path / "note.new").mkdir()  # as on a full disk, nothing can be written beside it
    assert leave(note, replace(LEFT, theta=(-0.5,))) == ""
    assert read(note) == replace(LEFT, theta=(-0.5,))
    note.unlink()
    assert leave(note, LEFT).startswith(f"{note}: ")


def test_a_note_that_could_not_be_written_is_tried_again(tmp_path):
    note, asked = tmp_path / "later" / "note", threading.Semaphore(0)

    def current():
        asked.release()
        return LEFT

    keeper = Keeper(str(note), current)
    for _ in range(2):
        assert asked.acquire(timeout=240)
    assert keeper.failure.startswith(f"{note}: ")
    note.parent.mkdir()
    keeper.close()
    assert keeper.failure == ""
    assert read(note) == LEFT


def test_a_note_is_written_when_it_is_new_and_a_last_time_at_the_end(tmp_path):
    note, asked, notes = tmp_path / "note", threading.Semaphore(0), [None]

    def current():
        asked.release()
        return notes[-1]

    keeper = Keeper(str(note), current)
    assert asked.acquire(timeout=240)
    assert not note.exists()
    notes.append(LEFT)
    keeper.hurry()
    for _ in range(2):  # the second time, the first one has been written
        assert asked.acquire(timeout=240)
    assert read(note) == LEFT
    notes.append(replace(LEFT, trip=TRIP))
    keeper.close()
    assert read(note).trip == TRIP
