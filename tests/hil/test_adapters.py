"""Rigs that speak standard messages join by parameters: their states in, a plain number out."""

import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from koop_msgs.msg import Cost, MeasuredState
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState

from koop_core.config.fields import check_fields, parse_source
from koop_core.config.parameter import ConfigError
from koop_node.node.managed import message_type
from koopman_lifter.config import LifterConfig


def test_a_standard_message_is_lifted_like_a_state(start, probe):
    start("koopman_lifter", measured="/joint_states:position[0],velocity[0]", listeners="probe")
    costs, states = probe.collect(Cost, "cost"), probe.collect(MeasuredState, "state")
    # a driver's usual quality of service: best effort
    rig = probe.node.create_publisher(JointState, "/joint_states", qos_profile_sensor_data)
    probe.spin_until(lambda: rig.get_subscription_count(), "the lifter")
    for k in range(5):
        message = JointState(position=[3.0 + k, 9.0], velocity=[4.0])
        message.header.stamp.sec, message.header.stamp.nanosec = 7, k * 5_000_000
        rig.publish(message)
        probe.spin_until(lambda k=k: len(costs) > k and len(states) > k, "state and cost")
    assert [c.step for c in costs] == [s.step for s in states] == list(range(1, 6))
    assert [list(s.x) for s in states] == [[3.0 + k, 4.0] for k in range(5)]
    reference = start_reference(start, probe, states)
    np.testing.assert_array_equal([c.y_out for c in costs], [c.y_out for c in reference])
    rig.publish(JointState())  # too short: a state that can't be used
    probe.spin_until(lambda: len(costs) > 5, "the answer")
    assert math.isnan(costs[5].r)


def test_a_rig_that_is_faster_than_the_model_is_told_so(start, probe):
    start("koopman_lifter", "-r", "__ns:=/rig", measured="joints:position[0],velocity[0]",
          listeners="probe")  # fmt: skip
    reports = probe.collect(DiagnosticArray, "/diagnostics")
    probe.collect(Cost, "/rig/cost")
    probe.collect(MeasuredState, "/rig/state")
    rig = probe.publisher(JointState, "/rig/joints")
    k, statuses = 0, []

    def warned():
        nonlocal k
        message = JointState(position=[3.0], velocity=[4.0])
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(k * 1_000_000, 10**9)
        rig.publish(message)
        k += 1
        statuses[:] = [
            status
            for report in reports
            for status in report.status
            if "faster than one message in dt = 0.005 s" in status.message
        ]
        return statuses

    probe.spin_until(warned, "the warning")
    assert statuses[0].level == DiagnosticStatus.WARN
    assert "koopman_lifter" in statuses[0].name


def start_reference(start, probe, states):
    """Return what the lifter answers if the rig speaks MeasuredState."""
    start("koopman_lifter", "-r", "__ns:=/reference", listeners="probe")
    answers = probe.collect(Cost, "/reference/cost")
    publisher = probe.publisher(MeasuredState, "/reference/state")
    for state in states[:5]:
        publisher.publish(state)
    probe.spin_until(lambda: len(answers) == 5, "the reference")
    return answers


def test_a_source_that_cannot_be_ends_the_lifter_with_one_line(start, probe):
    rig = probe.node.create_publisher(JointState, "/js", 10)
    probe.collect(Cost, "cost")
    probe.collect(MeasuredState, "state")
    process = start("koopman_lifter", measured="/js:torque[0]", cost="raw", listeners="probe")
    assert process.process.wait(60.0) == 1
    words = "JointState has no field 'torque' (it has header, name, position, velocity, effort)"
    assert words in process.log.read_text()
    probe.node.destroy_publisher(rig)


def test_what_is_wrong_with_a_source_is_said():
    with pytest.raises(ConfigError, match="write /topic:field or /topic:field,field"):
        LifterConfig(measured="/joint_states")
    with pytest.raises(ValueError, match="no_msgs/msg/No is not installed"):
        message_type("no_msgs/msg/No")
    with pytest.raises(ConfigError, match="JointState: 'effort' needs an index"):
        check_fields(parse_source("/js:effort").fields, JointState())
