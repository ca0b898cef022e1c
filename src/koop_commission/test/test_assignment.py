"""What is known of theta before a command, and what a commander is told."""

import json
from dataclasses import replace

from koop_commission.theta.assignment import Assignment
from koop_guard.note import find_theta
from koop_tune.rig.rig_file import RigFile

DT = 0.01
RIG = RigFile(
    "/a:x,y", "/b:z", DT, -1.0, 3.0, 0.5, 2.0, 0.5, channel_max=(5.0, 6.0),
)  # fmt: skip


def test_an_assignment_is_read_as_it_was_written():
    rig = replace(RIG, channel_min=(-1.0, -2.0))
    assignment = Assignment(rig, 1.5, "/state:x[0]", "a/msg/A", "b/msg/B", 1, "n", "/c")
    assert Assignment.from_json(json.loads(json.dumps(assignment.as_json()))) == assignment


def test_theta_is_where_it_was_left_unless_the_rig_was_restarted(tmp_path):
    note = tmp_path / "note"
    assert find_theta(None, RIG, ["a"]) == (RIG.theta_start, "")
    assert find_theta(note, RIG, ["a"]) == (RIG.theta_start, "")
    note.write_text("0.75 a b\n")
    assert find_theta(note, RIG, ["b"]) == (0.75, "")
    assert find_theta(note, RIG, []) == (0.75, "")  # not discovered yet
    theta, remark = find_theta(note, RIG, ["c"])
    assert theta == RIG.theta_start
    assert "restarted since theta was left at 0.75: assuming theta_start = 2" in remark
    for torn in ("", "abc", "9.0 a"):  # the last is beyond the limits
        note.write_text(torn)
        assert find_theta(note, RIG, ["a"]) == (RIG.theta_start, "")
