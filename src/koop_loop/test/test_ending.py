"""What ends a run, as docs/reference/exit-codes.md says it."""

import pytest

from koop_loop.ending import Ending, describe_end, ending


@pytest.mark.parametrize(
    ("node", "exit_code", "rig", "expected"),
    [
        ("vdp_plant", 0, False, Ending.DONE),
        ("vdp_plant", 1, False, Ending.FAILED),
        ("vdp_plant", -9, False, Ending.FAILED),
        ("koopman_lifter", 0, False, Ending.FAILED),
        ("relay_esc", 0, True, Ending.FAILED),
        ("relay_esc", -9, True, Ending.FAILED),
        ("rig", 0, True, Ending.DONE),
        ("rig", 3, True, Ending.FAILED),
        ("recorder", 1, False, Ending.FAILED),
        ("recorder", 1, True, Ending.GO_ON),
    ],
)
def test_a_rig_keeps_its_controller_when_the_recording_ends(node, exit_code, rig, expected):
    assert ending(node, exit_code, rig) is expected


def test_a_signal_is_named():
    assert describe_end("relay_esc", -14).startswith("relay_esc hung while it joined or left")
    assert describe_end("relay_esc", -9) == "relay_esc was killed by signal 9"
    assert describe_end("relay_esc", 2) == "relay_esc ended with exit code 2"
