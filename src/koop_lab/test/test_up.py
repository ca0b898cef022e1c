"""``koop up``: what it says of a run."""

from koop_bringup.live.monitor import Progress
from koop_lab.commands.up import StatusLine


def test_a_node_that_has_not_reported_is_said_to_be_starting(capsys):
    status = StatusLine(["koop_guard", "relay_esc"])
    guard = "koop_guard WARN: nothing is commanded"
    progress = Progress(
        values={"koop_guard": {}}, findings={"koop_guard": guard}, heard={"koop_guard": 1.0}
    )
    status.show(progress)
    assert f"{guard}; relay_esc: starting" in capsys.readouterr().out
    progress.heard["relay_esc"] = 2.0
    status._time = float("-inf")  # as a second later
    status.show(progress)
    assert capsys.readouterr().out.endswith(f"{guard}\n")
