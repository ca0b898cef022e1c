"""What is said of a running loop, by its nodes and by other programs under their names."""

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import Parameter, ParameterEvent, ParameterValue

from koop_bringup.live.monitor import Monitor
from koop_node.client.client import Client

pytestmark = pytest.mark.ros
FIGURES = {"r": "0.5", "step": "7", "rate_hz": "200.0", "theta": "1.5"}


def report(node, level=b"\0", **values):
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    status = DiagnosticStatus(name=f"{node}: koop", level=level, values=pairs)
    return DiagnosticArray(status=[status])


def test_what_no_node_of_a_loop_would_say_is_not_heard():
    with Monitor() as monitor, Client("other") as other:
        reports = other.node.create_publisher(DiagnosticArray, "/diagnostics", 1000)
        events = other.node.create_publisher(ParameterEvent, "/parameter_events", 1000)
        listens = lambda: reports.get_subscription_count() and events.get_subscription_count()  # noqa: E731
        other.wait_for(listens, 60.0, "the monitor to listen")
        for node in ("koopman_lifter", "relay_esc", "koop_guard"):
            reports.publish(report(node, **FIGURES))
        for name in FIGURES:
            reports.publish(report("koopman_lifter", **{**FIGURES, name: "much"}))
            reports.publish(report("koop_guard", **{**FIGURES, name: "[,"}))
        reports.publish(report("relay_esc", b"\x07", theta="2.5"))
        for size in (0, 3, 4, 20):
            for publisher in (reports, events):
                publisher.publish((b"\0\1\0\0" + b"\xff" * 20)[:size])
        unknown = Parameter(name="gain", value=ParameterValue(type=77))
        events.publish(ParameterEvent(node="/relay_esc", changed_parameters=[unknown]))
        reports.publish(report("relay_esc", **{**FIGURES, "theta": "9.5"}))  # not what the rig gets
        reports.publish(report("arm", b"\1", step="home"))
        progress = monitor.progress
        done = lambda: "relay_esc" in progress.changed and "arm" in progress.findings  # noqa: E731
        monitor.wait_for(done, 60.0, "the last")
        assert (progress.r, progress.step, progress.steps_per_second) == (0.5, 7, 200.0)
        assert progress.theta == [1.5]
        assert progress.values["koop_guard"] == FIGURES
        assert progress.changed["relay_esc"] == {"gain": None}
        assert progress.levels == {"koopman_lifter": 0, "relay_esc": 0, "koop_guard": 0, "arm": 1}
