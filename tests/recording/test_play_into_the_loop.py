"""A recorded run played to the real controller, which gives the recorded answers.

The bag that is played is compressed message by message, as rosbag2 can do it.
"""

from pathlib import Path

import pytest
import yaml
from koop_bag_compressed import compress
from koop_bag_ros import Player

from koop_bag.bag.diff import compare
from koop_bag.bag.reader import BagReader

pytestmark = pytest.mark.ros
GOLDEN = Path(__file__).parents[2] / "recordings" / "golden" / "run"


def test_played_in_lockstep_lifter_and_controller_answer_as_recorded(start, tmp_path):
    parameters = yaml.safe_load((GOLDEN / "parameters.yaml").read_text())
    lifter = parameters["/koopman_lifter"]["ros__parameters"]
    lifter["model"] = str(GOLDEN / "model" / Path(lifter["model"]).name)
    file = tmp_path / "parameters.yaml"
    file.write_text(yaml.safe_dump(parameters))
    recorder = start("recorder", output=tmp_path / "run")
    for node in ("relay_esc", "koopman_lifter"):
        start(node, "--params-file", str(file))
    packed = compress(GOLDEN / "bag", tmp_path / "packed", "MESSAGE")
    with Player(packed, pace="lockstep", listeners="recorder") as player:
        assert player.end() == 0, player.output()
    assert recorder.stop() == 0
    with BagReader(GOLDEN) as golden, BagReader(tmp_path / "run") as played:
        topics = {item.topic: item for item in compare(golden, played)}
    for topic in ("/state", "/cost", "/theta", "/ground_truth"):
        assert topics[topic].identical, topics[topic]
        assert topics[topic].compared == 2000
