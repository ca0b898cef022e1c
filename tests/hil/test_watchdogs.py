"""Watchdogs and /diagnostics of the nodes as processes: silence, disorder, a second publisher."""

import math
import re
from itertools import count, pairwise

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from koop_msgs.msg import ControlInput, Cost, MeasuredState, PlantTruth
from std_srvs.srv import Trigger

OK, WARN, ERROR, STALE = (
    DiagnosticStatus.OK,
    DiagnosticStatus.WARN,
    DiagnosticStatus.ERROR,
    DiagnosticStatus.STALE,
)


class Reports:
    """What the nodes say on /diagnostics."""

    def __init__(self, probe):
        self.probe = probe
        self.arrays = probe.collect(DiagnosticArray, "/diagnostics")

    def wait(self, node, level, text="", since=None):
        """Return the values of the next report of that level whose message holds the text.

        ``since`` counts the reports before the one that may be the next; default: those up to now.
        """
        observed = len(self.arrays) if since is None else since

        def actual():
            for array in self.arrays[observed:]:
                for status in array.status:
                    if status.name == node and status.level == level and text in status.message:
                        return {item.key: item.value for item in status.values}
            return None

        return self.probe.spin_until(actual, f"{node} to report {level} {text!r}")


@pytest.fixture
def reports(probe):
    return Reports(probe)


class Plant:
    """A plant in real time, answered by the test."""

    def __init__(self, start, probe, **parameters):
        probe.collect(MeasuredState, "state")
        self.probe, self.truths = probe, probe.collect(PlantTruth, "ground_truth")
        self.theta = probe.node.create_publisher(ControlInput, "theta", 10)
        start("vdp_plant", **parameters)
        probe.spin_until(lambda: self.truths and self.theta.get_subscription_count(), "the plant")

    def apply(self, theta, applied):
        """Answer the newest state, again on a busy machine, until it acts as it should."""
        asked = set()

        def acts():
            asked.add(step := self.truths[-1].step)
            self.theta.publish(ControlInput(step=step, theta=[theta]))
            return self.truths[-1].theta_applied[0] == applied

        self.probe.spin_until(acts, f"theta = {applied} to act")
        assert self.truths[-1].theta_step in asked


def test_the_plant_holds_theta_then_applies_the_safe_one_and_follows_again(start, probe, reports):
    plant = Plant(start, probe, theta_timeout=1.0, theta_safe_timeout=2.0, theta_safe=-1.0,
                  theta_rate=100.0)  # fmt: skip
    truths = plant.truths
    assert truths[0].theta_step == -1
    plant.apply(3.0, 3.0)
    begin = truths[-1]
    probe.spin_until(lambda: truths[-1].theta_applied[0] == -1.0, "the safe theta")
    after = [t for t in truths if begin.step <= t.step]
    left = next(t for t in after if t.theta_applied[0] != 3.0).header.stamp
    held = left.sec - begin.header.stamp.sec + 1e-9 * (left.nanosec - begin.header.stamp.nanosec)
    assert held > 1.9  # a tick may be earlier than its stamp
    # the ramp at 100 /s
    applied = [t.theta_applied[0] for t in after]
    assert max(abs(b - a) for a, b in pairwise(applied)) <= 0.5 + 1e-12
    assert truths[-1].theta_step == -1  # the safe theta answers nothing
    values = reports.wait("/vdp_plant", STALE, "nothing on 'theta'")
    assert (values["theta watchdog"], values["command"]) == ("stale", "safe")
    begin = truths[-1]
    plant.theta.publish(ControlInput(step=1, theta=[3.0]))
    reports.wait("/vdp_plant", STALE, "1 too old on 'theta'")
    plant.theta.publish(ControlInput(step=10**9, theta=[3.0]))
    reports.wait("/vdp_plant", ERROR, "step 1000000000: this run has published no such state")
    plant.apply(2.0, 2.0)
    # from -1 to 2, and never towards 3
    assert max(t.theta_applied[0] for t in truths if t.step >= begin.step) == 2.0


def test_the_plant_enforces_its_own_bounds_and_refuses_what_is_no_number(start, probe, reports):
    plant = Plant(start, probe, theta_min=-4.0, theta_max=4.0)
    plant.apply(1e9, 4.0)
    plant.theta.publish(ControlInput(step=1, theta=[math.nan]))
    reports.wait("/vdp_plant", ERROR, "theta = [nan]")
    assert plant.truths[-1].theta_applied[0] == 4.0


def test_silence_is_stale_and_a_second_publisher_is_an_error(start, probe, reports):
    start("koopman_lifter", listeners="probe")
    probe.collect(Cost, "cost")
    state = probe.publisher(MeasuredState, "state")
    state.publish(MeasuredState(step=0, x=[1.0, 2.0]))
    values = reports.wait("/koopman_lifter", STALE, "nothing on 'state' for")
    assert values["state watchdog"] == "stale"
    assert values["lifecycle_state"] == "active"
    assert len(values["model_id"]) == 12
    probe.node.create_publisher(MeasuredState, "state", 10)
    values = reports.wait("/koopman_lifter", ERROR, "2 publishers on 'state'")
    assert values["state publishers"] == "2"


def test_lost_late_and_unusable_states_are_counted(start, probe, reports):
    start("koopman_lifter", listeners="probe")
    answers = probe.collect(Cost, "cost")
    state = probe.publisher(MeasuredState, "state")
    for step in (0, 1, 5, 4, 6, 6):
        state.publish(MeasuredState(step=step, x=[1.0, 2.0]))
    probe.spin_until(lambda: len(answers) == 5, "the answers")
    values = reports.wait("/koopman_lifter", STALE)
    assert [a.step for a in answers] == [0, 1, 5, 6, 6]  # an overtaken state is not answered
    counted = [values[f"state {name}"] for name in ("missed_steps", "late", "repeated")]
    assert counted == ["3", "1", "1"]
    state.publish(MeasuredState(step=7, x=[1.0]))
    values = reports.wait("/koopman_lifter", ERROR, "state has 1 values")
    assert values["state unusable"] == "1"


def test_the_controller_restarts_after_a_silence_without_turning(start, probe, reports):
    start("relay_esc", dwell=1.0, step_size=0.001, listeners="probe")
    answers = probe.collect(ControlInput, "theta")
    cost = probe.publisher(Cost, "cost")

    def send(steps, r):
        for k in steps:
            cost.publish(Cost(step=k, r=r(k), dt=0.005, lockstep=True))
        probe.spin_until(lambda: answers and answers[-1].step == steps[-1], "the answers")

    send(range(300), lambda k: 1.0 - 1e-4 * k)  # falls for longer than the dwell time
    before = answers[-1]
    reports.wait("/relay_esc", STALE, "nothing on 'cost'")
    send(range(1000, 1150), lambda k: 50.0 + 1e-6 * k)  # another level, rising at first
    after = answers[-150:]
    assert after[0].theta[0] == before.theta[0]
    assert {a.epsilon for a in after} == {before.epsilon}
    assert after[0].cost_rise_filtered == 0.0
    send(range(1150, 1300), lambda k: 50.0 + 1e-6 * k)  # still rising when the dwell time is over
    assert answers[-1].epsilon == -before.epsilon


def test_a_controller_whose_costs_say_no_sampling_time_reports_it_and_joins_when_they_do(
    start, probe, reports
):
    process = start("relay_esc", listeners="probe")
    answers = probe.collect(ControlInput, "theta")
    cost = probe.publisher(Cost, "cost")
    cost.publish(Cost(step=0, r=1.0))
    reports.wait("/relay_esc", ERROR, "last step 0: r = nan, dt = 0.0 s")
    for k in range(1, 5):
        cost.publish(Cost(step=k, r=1.0, dt=0.005, lockstep=True))
    probe.spin_until(lambda: len(answers) == 5, "the answers")
    assert [a.holding for a in answers] == [True] * 5
    assert process.log.read_text().count("the costs are 0.005 s apart") == 1


def test_a_cost_that_has_risen_for_good_is_reported(start, probe, reports):
    start("relay_esc", dwell=0.05, listeners="probe")
    answers = probe.collect(ControlInput, "theta")
    cost, steps = probe.publisher(Cost, "cost"), count()
    said = r"the cost is (\S+) times the least of this run: the optimum may have moved"

    def send(samples, r):
        for k in (next(steps) for _ in range(samples)):
            cost.publish(Cost(step=k, r=r, dt=0.005, lockstep=True))
        probe.spin_until(lambda: answers[-1:] and answers[-1].step == k, "the answers")

    def reported():
        messages = (s.message for array in reports.arrays for s in array.status)
        return [float(rise) for text in messages for rise in re.findall(said, text)]

    for _ in range(80):  # a window is of 200 dwell times, at least 2000 samples
        send(100, 1.0)
    for _ in range(20):
        send(100, 1e-9)  # the rig is off
    assert not reported()
    for _ in range(20):
        send(100, 5.0)
    probe.spin_until(lambda: send(1, 5.0) or reported(), "the finding")
    assert 3.0 < reported()[0] <= 5.0


def test_a_reset_ramps_theta_back_at_the_rate_limit(start, probe):
    start(
        "relay_esc", rate_limit=0.2, step_size=0.001, dwell=100.0, listeners="probe"
    )  # 0.001 a step
    answers = probe.collect(ControlInput, "theta")
    cost = probe.publisher(Cost, "cost")

    def send(steps):
        for k in steps:
            cost.publish(Cost(step=k, r=1.0, dt=0.005, lockstep=True))
        probe.spin_until(lambda: answers and answers[-1].step == steps[-1], "the answers")

    send(range(51))
    assert answers[-1].theta[0] == pytest.approx(1.95)
    assert probe.call(Trigger, "/relay_esc/reset", Trigger.Request()).success
    send(range(51, 200))
    changes = [b.theta[0] - a.theta[0] for a, b in pairwise(answers)]
    assert max(changes) == pytest.approx(0.001)
    assert max(a.theta[0] for a in answers[60:]) > 1.97
