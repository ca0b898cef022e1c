"""Several nodes in one process: what becomes of the others when one ends, and what is refused."""

import subprocess

import pytest
from koop_msgs.msg import Cost, MeasuredState
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState

from koop_bringup.live.process import executable

pytestmark = pytest.mark.ros

LOOP = ("relay_esc::EscNode", "koopman_lifter::LifterNode")


def test_nodes_of_a_container_keep_names_parameters_and_lifecycle_and_end_together(start, probe):
    file = start.folder / "loop.yaml"
    file.write_text(
        "/**/relay_esc: {ros__parameters: {theta_initial: 1.5}}\n"
        "/rig/koopman_lifter: {ros__parameters: {cost: raw}}\n"
    )
    components = [LOOP[0], f"{LOOP[1]}@/rig"]
    container = start("container", "--params-file", str(file), "--", *components)
    names = probe.node.get_node_names_and_namespaces
    probe.spin_until(
        lambda: ("koopman_lifter", "/rig") in names() and ("relay_esc", "/") in names()
    )
    costs = probe.collect(Cost, "/rig/cost")
    states = probe.publisher(MeasuredState, "/rig/state")
    probe.spin_until(lambda: probe.node.count_publishers("/rig/cost"))
    states.publish(MeasuredState(step=0, x=[3.0, 4.0]))
    probe.spin_until(lambda: costs, "a cost")
    assert costs[0].y_out == pytest.approx((25 / 2) ** 0.5)
    shutdown = probe.node.create_client(ChangeState, "/relay_esc/change_state")
    probe.spin_until(shutdown.service_is_ready, "the service")
    number = Transition.TRANSITION_ACTIVE_SHUTDOWN  # after which it may not come to an answer
    shutdown.call_async(ChangeState.Request(transition=Transition(id=number)))
    assert container.process.wait(60.0) == 1
    assert "[relay_esc]: has ended: the other nodes end with it" in container.log.read_text()


def test_the_end_of_one_ends_all_with_its_exit_code(start):
    container = start(
        "container", "-p", "koopman_lifter:model:=/nowhere.npz", "--", LOOP[1], LOOP[0]
    )
    assert container.process.wait(60.0) == 1
    assert "/nowhere.npz" in container.log.read_text()


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (["--help"], 0, "vdp_plant::PlantNode"),
        ([], 2, "COMPONENT"),
        (["koop::Nothing"], 2, "there is no component 'koop::Nothing'; there are koop_bag::"),
        ([LOOP[0], "--ros-args", "-p", "dwel:=1.0"], 2, "dwel"),
        ([LOOP[0], LOOP[0]], 2, "two nodes are named /relay_esc: put one into a namespace"),
        ([*LOOP, "--ros-args", "-p", "dwell:=1.0"], 2, "'-p NODE:NAME:=VALUE' for one"),
    ],
)
def test_a_container_says_in_one_line_what_it_cannot_do(own_domain, words, code, text):
    done = subprocess.run(
        [executable("container"), *words], capture_output=True, text=True, timeout=240
    )
    assert done.returncode == code
    assert text in done.stdout + done.stderr
    assert "Traceback" not in done.stderr
