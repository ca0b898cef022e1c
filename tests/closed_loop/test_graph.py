"""Who publishes and who listens, by name: publishers of another kind, observers, an end."""

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from koop_msgs.msg import ControlInput, Cost, MeasuredState
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64

BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
pytestmark = pytest.mark.ros


class Levels:
    """The last level and message of every node."""

    def __init__(self, probe):
        self.reports = probe.collect(DiagnosticArray, "/diagnostics")

    def of(self, node):
        return next(
            (
                (status.level, status.message)
                for report in reversed(self.reports)
                for status in report.status
                if status.name == f"/{node}"
            ),
            (None, ""),
        )


def test_a_sensor_that_begins_later_and_offers_best_effort_is_heard(start, probe):
    costs, levels = probe.collect(Cost, "cost"), Levels(probe)
    start("koopman_lifter", listeners="probe")
    probe.spin_until(lambda: "no publisher" in levels.of("koopman_lifter")[1], "the report")
    assert levels.of("koopman_lifter")[0] == DiagnosticStatus.WARN
    sensor = probe.node.create_publisher(MeasuredState, "state", BEST_EFFORT)

    def measure():
        sensor.publish(MeasuredState(step=1, x=[1.0, 2.0]))
        return costs

    probe.spin_until(measure, "a cost")


def test_a_publisher_of_another_type_is_named_in_the_log_and_on_diagnostics(start, probe):
    probe.collect(Cost, "cost")
    levels = Levels(probe)
    probe.node.create_publisher(Float64, "state", 10)
    lifter = start("koopman_lifter", listeners="probe")
    text = "'/state' is published by /probe as std_msgs/msg/Float64, not as koop_msgs/msg/Meas"
    probe.spin_until(lambda: text in levels.of("koopman_lifter")[1], "the report")
    assert levels.of("koopman_lifter")[0] == DiagnosticStatus.ERROR
    assert text in lifter.log.read_text()


def test_observers_are_not_taken_for_the_lifter(start, probe):
    """Nor is one that comes first: the plant begins with the lifter's first look at a state."""
    levels = Levels(probe)
    states = probe.collect(MeasuredState, "state")
    plant = start("vdp_plant", pace="lockstep")
    waiting = "waiting for the next node of the loop to listen to /state"
    probe.spin_until(lambda: waiting in levels.of("vdp_plant")[1], "the report")
    assert levels.of("vdp_plant")[0] == DiagnosticStatus.WARN
    start("relay_esc")
    probe.spin_until(lambda: probe.node.count_publishers("theta"), "the controller")
    assert not states
    start("koopman_lifter")
    probe.spin_until(lambda: states and states[-1].step > 100, "the loop")
    assert plant.poll() is None


def test_a_listener_that_is_named_is_waited_for(start, probe):
    thetas = probe.node.create_publisher(ControlInput, "theta", 10)  # a node of the loop
    levels = Levels(probe)
    plant = start("vdp_plant", listeners="next scope", pace="realtime")
    probe.collect(MeasuredState, "state")
    waiting = "waiting for scope to listen to /state; scope to listen to /ground_truth"
    probe.spin_until(lambda: waiting in levels.of("vdp_plant")[1], "the report")
    assert plant.poll() is None
    assert thetas.get_subscription_count() == 1


def test_the_end_of_the_plant_is_an_end_for_all_and_no_fault(start, probe):
    """Three terminals: the controller learns of the end through the lifter, which goes on."""
    levels = Levels(probe)
    start("relay_esc")
    start("koopman_lifter")
    plant = start("vdp_plant", duration=1.0)
    probe.spin_until(lambda: plant.poll() is not None, "the end of the plant")
    assert plant.poll() == 0
    for node, topic in (("relay_esc", "cost"), ("koopman_lifter", "state")):
        text = f"'{topic}' has ended at step 199"
        probe.spin_until(lambda n=node, t=text: t in levels.of(n)[1], text)
        assert levels.of(node)[0] == DiagnosticStatus.OK


def test_a_quality_of_service_by_parameter_is_refused(start):
    words = ("-p", "qos_overrides./state.subscription.reliability:=best_effort")
    lifter = start("koopman_lifter", *words)
    assert lifter.process.wait(60.0) == 2
    assert "the quality of service of the topics is fixed" in lifter.log.read_text()
