"""What is known of theta before a command."""

from koop_guard.config import GuardConfig
from koop_guard.note import find_theta

RIG = GuardConfig(
    measured="/a:x,y", command="/b:z", theta_min=-1.0, theta_max=3.0, theta_start=2.0,
    theta_safe=0.5,
)  # fmt: skip


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
