"""The nodes as a lifecycle manager meets them."""

import itertools

from diagnostic_msgs.msg import DiagnosticArray
from koop_msgs.msg import ControlInput, Cost, MeasuredState
from std_srvs.srv import SetBool

from koopman_lifter.config import shipped_model


def test_one_controller_hands_over_to_another_and_never_do_two_publish(start, probe):
    """Both are there all the time; theta says by its value whose it is."""
    thetas, reports = (
        probe.collect(ControlInput, "theta"),
        probe.collect(DiagnosticArray, "/diagnostics"),
    )
    start("vdp_plant")
    start("koopman_lifter")
    start("relay_esc", step_size=0.0, theta_initial=1.0)
    start("relay_esc", "-r", "__node:=second", autostart="false", step_size=0.0, theta_initial=2.0)
    assert probe.change_state("/second", "configure")
    publishers = set()

    def from_now_on(theta, count=100):
        """Wait until so many more thetas have come; all of them are of this controller."""
        begin = len(thetas)

        def enough():
            publishers.add(probe.node.count_publishers("theta"))
            return len(thetas) >= begin + count

        probe.spin_until(enough, f"theta = {theta}")
        assert {message.theta[0] for message in thetas[begin:]} == {theta}

    probe.spin_until(lambda: thetas, "the loop")
    from_now_on(1.0)
    assert probe.call(SetBool, "/relay_esc/hold", SetBool.Request(data=True)).success
    probe.spin_until(lambda: thetas[-1].holding, "a held theta")
    from_now_on(1.0)  # held is not silent
    assert all(message.holding for message in thetas[-100:])

    for active, standby, theta in (("/relay_esc", "/second", 2.0), ("/second", "/relay_esc", 1.0)):
        assert probe.change_state(active, "deactivate")
        assert probe.state_of(active) == "inactive"
        begin, silence = len(thetas), len(reports)
        probe.spin_until(lambda n=silence: len(reports) > n + 3, "a second of reports")
        assert {m.theta[0] for m in thetas[begin:]} <= set()
        assert probe.change_state(standby, "activate")
        probe.spin_until(lambda n=begin: len(thetas) > n, f"{standby} to take over")
        from_now_on(theta)
    assert publishers == {1}
    values = [message.theta[0] for message in thetas]
    assert [theta for theta, _ in itertools.groupby(values)] == [1.0, 2.0, 1.0]
    texts = {status.message for array in reports for status in array.status}
    assert not [text for text in texts if "publishers" in text]


def test_a_configure_that_fails_leaves_nothing_and_the_next_one_works(start, probe, tmp_path):
    missing = tmp_path / "model.npz"
    start("koopman_lifter", autostart="false", model=missing)
    assert not probe.change_state("/koopman_lifter", "configure")
    assert probe.state_of("/koopman_lifter") == "unconfigured"
    missing.write_bytes(shipped_model().read_bytes())
    for _ in range(2):  # and again after a clean-up
        assert probe.change_state("/koopman_lifter", "configure")
        assert probe.change_state("/koopman_lifter", "activate")
        assert probe.state_of("/koopman_lifter") == "active"
        costs = probe.collect(Cost, "cost")
        states = probe.publisher(MeasuredState, "state")
        states.publish(MeasuredState(step=0, x=[1.0, 2.0]))
        probe.spin_until(lambda costs=costs: costs, "the cost")
        assert probe.node.count_publishers("cost") == 1
        assert probe.change_state("/koopman_lifter", "deactivate")
        assert probe.change_state("/koopman_lifter", "cleanup")
        assert probe.state_of("/koopman_lifter") == "unconfigured"
        probe.spin_until(lambda: not probe.node.count_publishers("cost"), "the cost to go")
        probe.node.destroy_publisher(states)
