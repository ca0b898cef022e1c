"""What the controller of a guarded rig goes on from, written and read again."""

import json

import pytest

from koop_bringup.live.memory import Memory
from koop_bringup.live.monitor import Progress
from koop_bringup.plan import plan

GUARDED = """
koopman_lifter: {ros__parameters: {cost: raw, measured: '/rig:data[0]'}}
relay_esc: {ros__parameters: {theta_max: 3.0, dwell: 2.0}}
koop_guard: {ros__parameters: {measured: '/rig:data[0]', command: '/rig/theta:data'}}
"""
BEGIN = [0.1 + 0.2, -1.0, *(float(k) for k in range(13))]


@pytest.fixture
def memory(tmp_path):
    """Return the memory of a loop as its file says, or another text."""

    def make(text=GUARDED):
        (tmp_path / "rig.yaml").write_text(text)
        return Memory(plan({"params": str(tmp_path / "rig.yaml")}))

    return make


def progress(begin, status="following", **changed):
    values = {"relay_esc": {"begin": json.dumps(begin)}, "koop_guard": {"status": status}}
    return Progress(values=values, changed=changed)


def test_what_is_kept_is_recalled_to_the_bit_where_the_rig_followed(memory, tmp_path):
    assert memory().recall() == ({}, "")
    memory().keep(progress(BEGIN, "tripped"))
    assert memory().recall() == ({}, "")
    kept = memory()
    kept.keep(progress(BEGIN))
    kept.keep(progress([0.0] * 12))  # within the same second
    values, remark = memory().recall()
    assert values == {"koopman_lifter": {}, "relay_esc": {"begin": BEGIN}}
    assert remark == "the controller resumes where it was when the loop ended"
    assert [path.name for path in tmp_path.iterdir() if path.name != "rig.yaml"] == [
        ".rig.yaml.controller"
    ]


def test_what_no_controller_says_is_not_kept(memory):
    for text in ("", "[", "[" * 100_000, "null"):
        said = progress(BEGIN)
        said.values["relay_esc"]["begin"] = text
        memory().keep(said)
        assert memory().recall() == ({}, "")


def test_bytes_that_another_program_sets_end_no_loop(memory, capsys):
    """Failed before: the loop ended with a traceback."""
    memory().keep(progress(BEGIN, relay_esc={"dwell": [b"\0"]}))
    assert "not JSON serializable: a restart begins at theta_initial" in capsys.readouterr().err
    assert memory().recall() == ({}, "")


def test_what_was_set_while_the_loop_ran_outlives_two_restarts(memory):
    first = {"relay_esc": {"dwell": 0.5, "theta_max": 2.0, "listeners": "x"}, "other": {"a": 1}}
    memory().keep(progress(BEGIN, **first))
    second = memory()
    values, remark = second.recall()
    assert values["relay_esc"] == {"dwell": 0.5, "theta_max": 2.0, "begin": BEGIN}
    assert "set while it ran: relay_esc.dwell = 0.5, relay_esc.theta_max = 2.0" in remark
    lifter = {"omega_l": 2.0, "begin": 1.1}
    second.keep(progress(BEGIN, koopman_lifter=lifter, relay_esc={"dwell": 1.5}))
    values, _ = memory().recall()
    assert values["koopman_lifter"] == lifter
    assert values["relay_esc"] == {"dwell": 1.5, "theta_max": 2.0, "begin": BEGIN}
    values, remark = memory(GUARDED.replace("dwell: 2.0", "dwell: 2.5")).recall()
    assert values == {}  # what the user gave wins
    assert "is of another relay_esc.dwell" in remark


def test_a_model_that_was_set_while_the_loop_ran_is_used_again_unless_it_is_gone(memory, tmp_path):
    model = tmp_path / "model-1.npz"
    model.write_bytes(b"a model")
    memory().keep(progress(BEGIN, koopman_lifter={"model": str(model)}))
    assert memory().recall()[0]["koopman_lifter"] == {"model": str(model)}
    model.unlink()
    values, remark = memory().recall()
    assert values == {}
    assert "is gone: the controller begins at theta_initial" in remark


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("theta_max: 3.0", "theta_max: 2.5", "relay_esc.theta_max"),
        ("dwell: 2.0", "law: adaptive", "relay_esc.dwell, relay_esc.law"),
        ("cost: raw", "cost: lifted", "koopman_lifter.cost"),
        ("/rig/theta", "/other/theta", "koop_guard.command"),
    ],
)
def test_a_file_of_another_loop_is_not_recalled(memory, old, new, said):
    memory().keep(progress(BEGIN))
    values, remark = memory(GUARDED.replace(old, new)).recall()
    assert values == {}
    assert f".rig.yaml.controller is of another {said}: the controller begins at" in remark


@pytest.mark.parametrize(
    ("part", "torn"),
    [
        (None, ""), (None, "{"), (None, "[1]"), ("of", 1), ("begin", [1.0]), ("changed", 1),
        ("changed", {"relay_esc": {"theta_max": -9.0}}), ("changed", {"relay_esc": 1}),
    ],
)  # fmt: skip
def test_a_damaged_file_is_not_recalled(memory, tmp_path, part, torn):
    memory().keep(progress(BEGIN))
    file = tmp_path / ".rig.yaml.controller"
    if part is None:
        file.write_text(torn)
    else:
        file.write_text(json.dumps(json.loads(file.read_text()) | {part: torn}))
    values, remark = memory().recall()
    assert values == {}
    assert remark.endswith("the controller begins at theta_initial")


def test_a_loop_without_a_guard_has_no_memory(memory, tmp_path):
    bare = memory("relay_esc: {ros__parameters: {dwell: 2.0}}")
    bare.keep(progress(BEGIN))
    assert bare.recall() == ({}, "")
    assert [path.name for path in tmp_path.iterdir()] == ["rig.yaml"]


def test_a_disk_that_is_full_ends_no_loop_and_what_is_kept_is_written_when_it_is_not(
    memory, tmp_path, capsys, monkeypatch
):
    """Failed before: nothing was kept any more, and the next loop did not say so."""
    full, kept = tmp_path / ".rig.yaml.controller.new", memory()
    full.symlink_to("/dev/full")
    kept.keep(progress(BEGIN))
    assert "make room: a restart begins at theta_initial" in capsys.readouterr().err
    monkeypatch.setattr("koop_bringup.live.memory.PERIOD", 0.0)
    kept.keep(progress(BEGIN))  # the link was removed
    full.symlink_to("/dev/full")
    later = [0.5, *BEGIN[1:]]
    kept.keep(progress(later))
    assert "make room: a restart begins where that says" in capsys.readouterr().err
    full.symlink_to("/dev/full")
    kept.keep(progress(later))
    assert capsys.readouterr().err == ""  # told once
    full.symlink_to("/dev/full")
    values, remark = memory().recall()
    assert values["relay_esc"] == {"begin": BEGIN}
    assert "make room: the controller resumes where it was when that could be written" in remark
    kept.keep(progress(later))
    assert memory().recall()[0]["relay_esc"] == {"begin": later}
