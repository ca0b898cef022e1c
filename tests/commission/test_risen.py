"""A rig that swings more than it did, whatever theta is, over DDS: the controller says so."""

import signal

import pytest
from test_excite import wait
from test_guard import LONG, LOOP

from koop_bag.bag.reader import BagReader
from koop_core.config import parameter_file

pytestmark = pytest.mark.ros
SAID = "times the least of this run: the optimum may have moved"


def test_a_cost_that_has_risen_for_good_is_reported_and_recorded(fast_rig, koop, tmp_path):
    values = {**LOOP, "relay_esc": {**LOOP["relay_esc"], "dwell": 0.04}}  # a window takes 8 s
    parameter_file.write(values, tmp_path / "loop.yaml")
    text = (tmp_path / "loop.yaml").read_text().replace("/**/", "/")
    (tmp_path / "loop.yaml").write_text(text)
    process, log = koop("up", "loop.yaml", "--out", "run"), tmp_path / "run/logs/relay_esc.log"
    wait(lambda: len(fast_rig.moved) > 4500, "two windows", process, LONG)
    assert SAID not in log.read_text()
    fast_rig.louder = 4.0
    wait(lambda: SAID in log.read_text(), "the finding", process, LONG)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=LONG)
    assert process.returncode == 0, error
    with BagReader(tmp_path / "run" / "bag") as bag:
        assert any(SAID.encode() in message.data for message in bag.messages(["/diagnostics"]))
