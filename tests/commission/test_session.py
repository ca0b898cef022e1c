"""A session: whose fault a silence is."""

import time

import pytest
from commission_rig import RIG

from koop_bringup.live.loop import LiveNodes
from koop_commission.rig.listener import Listener
from koop_commission.stages.session import Session, Watch
from koop_commission.theta.limits import SAFETY
from koop_node.client.client import Client

pytestmark = pytest.mark.ros


def test_a_command_that_was_held_up_does_not_call_the_rig_silent(fast_rig, tmp_path):
    held_up = SAFETY.silence(RIG) + 0.2
    with Client("session") as client:
        source = RIG.state
        listener = Listener(client, source.topic, RIG.measured_type, source.fields)
        run = Session(RIG, Watch(), client, LiveNodes(tmp_path, {}), listener)
        client.wait_for(lambda: listener.count, 10.0, "the rig")
        time.sleep(held_up)
        assert not run.is_silent()
        fast_rig.silent = True
        time.sleep(held_up)  # what was said before it fell silent is heard only now
        assert run.is_silent()
