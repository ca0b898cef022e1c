"""From folders to bags, and what is in them."""

from dataclasses import replace

import numpy as np
import pytest
from surrogate_rigs import make_amplitude

from koop_bag.bag.writer import BagWriter, WriterOptions
from koop_bag.cdr.schema import load_schema
from koop_core.config.objects import to_json
from koop_core.config.parameter import ConfigError
from koop_tune.excitation import progress
from koop_tune.excitation.amplitude import Windows
from koop_tune.excitation.design import KNOWN, TIME
from koop_tune.folder import CONTROLLER, FIGURES, TUNED, find_controller
from koop_tune.rig.rig_file import RigFile
from koop_tune.tune_folders import find_bags, load_since, reading_of, tune_folders

RIG = RigFile(
    "/state:x[0],x[1]", "/knob:data", 0.01, 0.0, 1.0, 0.5, 0.5, 0.5,
)  # fmt: skip
KNOB = np.dtype([("encoding", "<u4"), ("data", "<f8")])
ANSWER = np.dtype(
    {"names": ["encoding", "frame_id", "step", "theta"], "formats": ["<u4", "<u4", "<u8", "<f8"],
     "offsets": [0, 12, 20, 28], "itemsize": 92}
)  # fmt: skip


def write(folder, topics, states=True):
    """Write a bag of 50 states of two channels, and of the topics of theta that are named."""
    state = np.dtype(
        {"names": ["encoding", "frame_id", "step", "count", "x"],
         "formats": ["<u4", "<u4", "<u8", "<u4", ("<f8", 2)],
         "offsets": [0, 12, 20, 32, 36], "itemsize": 52}
    )  # fmt: skip
    kinds = {
        "/knob": ("std_msgs/msg/Float64", KNOB),
        "/theta": ("koop_msgs/msg/ControlInput", ANSWER),
    }
    with BagWriter(folder, WriterOptions(compression="none")) as bag:
        own = bag.add_topic("/state", load_schema("koop_msgs/msg/MeasuredState"))
        ids = {name: bag.add_topic(name, load_schema(kinds[name][0])) for name in topics}
        for k in range(50):
            at = 1_000_000_000 + k * 10_000_000
            for name, number in ids.items():
                message = np.zeros(1, kinds[name][1])
                message["encoding"] = 0x0100
                bag.write_many([(at, number, at, message.tobytes())])
            if states:
                message = np.zeros(1, state)
                message["encoding"], message["frame_id"], message["count"] = 0x0100, 1, 2
                message["step"] = k
                bag.write_many([(at, own, at, message.tobytes())])
    return folder


def test_the_loops_own_topics_are_read_where_the_bag_has_them(tmp_path):
    other = replace(RIG, measured="/rig:data[0],data[1]")
    windows = Windows(800, other.dt)  # 8 periods of the oscillation
    loop = reading_of(write(tmp_path / "loop", ["/theta", "/knob"]), other, windows)
    assert (str(loop.measured), *map(str, loop.commands)) == ("/state:x", "/theta:theta[0]")
    bare = reading_of(write(tmp_path / "bare", ["/knob"], states=False), other, windows)
    assert (str(bare.measured), *map(str, bare.commands)) == ("/rig:data[0],data[1]", "/knob:data")
    assert bare.dt == other.dt
    assert bare.gap == pytest.approx(50.0 * other.dt)  # half a period
    assert reading_of(tmp_path / "bare", other, Windows(64, other.dt)).gap == pytest.approx(
        4.0 * other.dt
    )
    assert reading_of(tmp_path / "bare", other, Windows(32, other.dt)).gap is None  # three dt


def test_the_bags_of_an_excitation_are_those_of_its_parts(tmp_path, capsys):
    state = progress.ExcitationProgress(Windows(64, 0.01), make_amplitude(64, 0.01))
    state.parts = ["part-1", "part-2", "part-3"]  # the second one got no message
    progress.save(state, RIG, tmp_path)
    for part in ("part-1", "part-3"):
        write(tmp_path / part / "bag", ["/knob"])
    loop = write(tmp_path / "verify-1" / "bag", ["/theta"])
    bags, read = find_bags([tmp_path, tmp_path / "verify-1"], RIG)
    assert bags == [tmp_path / "part-1/bag", tmp_path / "part-3/bag", loop]
    assert to_json(read.amplitude) == to_json(state.amplitude)
    assert "not finished" in capsys.readouterr().out
    bags, read = find_bags([loop], RIG)
    assert (bags, read.amplitude) == ([loop], None)


@pytest.mark.parametrize(("amplitude", "count"), [(make_amplitude(64, 0.01), 20), (None, 50)])
def test_all_of_a_recording_is_looked_at_where_nothing_reacted(tmp_path, amplitude, count):
    """Failed before: 'theta was held at 2 values' was said of a rig that was excited in vain."""
    state = progress.ExcitationProgress(Windows(64, 0.01), amplitude, since=0.3)
    bag = write(tmp_path / "bag", ["/knob"])
    assert load_since([bag], RIG, state)[0].x.shape == (2, count)
    end = replace(state, elapsed=RIG.time).describe_end(RIG)
    assert ("koop check" in end) == (amplitude is None)


@pytest.mark.parametrize("ended", ["", TIME, KNOWN])
def test_several_knobs_are_not_judged_by_those_that_were_gone_over_so_far(tmp_path, capsys, ended):
    rig = replace(RIG, command="/knob:data,/other:data")
    lines = [progress.SectionLine(0, (0.5, 0.5))]
    state = progress.ExcitationProgress(parts=["part-1"], sections=lines, ended=ended)
    progress.save(state, rig, tmp_path)
    write(tmp_path / "part-1" / "bag", ["/knob"])
    _, read = find_bags([tmp_path], rig)
    assert read.sections == (lines if ended == KNOWN else [])
    assert ("not finished" in capsys.readouterr().out) == (ended != KNOWN)


def test_folders_without_a_recording_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="does not exist"):
        find_bags([tmp_path / "no"], RIG)
    progress.save(progress.ExcitationProgress(), RIG, tmp_path)
    with pytest.raises(ConfigError, match="no recording found: run 'koop excite' first"):
        find_bags([tmp_path], RIG)
    with pytest.raises(ConfigError, match="was begun with theta_max"):
        find_bags([tmp_path], replace(RIG, theta_max=2.0))


def test_a_recording_of_other_channels_is_refused(tmp_path):
    write(tmp_path / "bag", ["/knob"])
    three = replace(RIG, measured="/state:x[0],x[1],x[2]")
    with pytest.raises(ConfigError, match="/state:x has 2 channels, the rig file 3"):
        tune_folders(three, [tmp_path / "bag"], tmp_path / "out")
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / CONTROLLER).write_text("")
    with pytest.raises(ConfigError, match="exists already: choose another --out"):
        tune_folders(RIG, [tmp_path / "bag"], tmp_path / "there")


def test_a_controller_is_found_by_its_file_or_a_folder_above_it(tmp_path):
    file = tmp_path / "rig" / TUNED / CONTROLLER
    file.parent.mkdir(parents=True)
    file.write_text("")
    assert find_controller(file) == (file, "controller")
    assert find_controller(tmp_path / "rig") == (file, "rig")
    assert find_controller(file.parent)[0] == file
    with pytest.raises(ConfigError, match="run 'koop tune' first"):
        find_controller(tmp_path)
    file.rename(file.with_name(FIGURES))  # as after a refusal
    with pytest.raises(ConfigError, match="made none, and says why in tuned"):
        find_controller(tmp_path / "rig")


def test_an_excitation_of_several_knobs_is_read_as_it_was_written(tmp_path):
    rig = replace(RIG, command="/a:x,/b:x", theta_min=(0.0, -2.0), theta_safe=(0.5, 0.25))
    held = progress.HoldSummary((0.5, -1.0), 0.1, 0.01, 1.0, 9.0, "a reason")
    lines = [progress.SectionLine(1, (0.5, 0.25))]
    state = progress.ExcitationProgress(holds=[held], parts=["part-1"], sections=lines)
    progress.save(state, rig, tmp_path)
    assert progress.read(tmp_path) == (rig, state)
    with pytest.raises(
        ConfigError, match=r"begun with theta_min = \[0.0, -2.0\], the rig file says"
    ):
        progress.load(replace(rig, theta_min=(0.0, -1.0)), tmp_path)
