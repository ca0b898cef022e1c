"""A recorded run played to the real controller, which gives the recorded answers.

The bag that is played is compressed message by message, as rosbag2 can do it.
"""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from koop_bag_compressed import compress

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
    options = ["--pace", "lockstep", "--wait-for", "state:2 ground_truth"]
    command = [sys.executable, "-m", "koop_lab", "bag", "play", str(packed), *options]
    player = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert player.returncode == 0, player.stderr
    assert recorder.stop() == 0
    with BagReader(GOLDEN) as golden, BagReader(tmp_path / "run") as played:
        found = {item.topic: item for item in compare(golden, played)}
    for topic in ("/state", "/cost", "/theta", "/ground_truth"):
        assert found[topic].identical, found[topic]
        assert found[topic].compared == 2000
