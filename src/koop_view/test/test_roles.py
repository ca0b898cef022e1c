"""The loops that are found among the nodes and topics of a domain."""

from koop_view.roles import COST, GONE, GUARD, STATE, THETA, KnownLoops, LoopNames, find_loops


def test_loops_are_told_apart_by_namespace_and_by_what_their_nodes_publish():
    actual = find_loops({
        "/vdp_plant": {"/state": STATE, "/rosout": "rcl_interfaces/msg/Log"},
        "/koopman_lifter": {"/cost": COST},
        "/relay_esc": {"/a_command": THETA, "/theta": THETA},
        "/rig/lifter": {"/rig/cost": COST, "/rig/state": STATE},  # of a rig's own message
        "/recorder": {"/rosout": "rcl_interfaces/msg/Log"},
    }, {"/a_copy": STATE, "/rig/clock": "rosgraph_msgs/msg/Clock"})  # fmt: skip
    assert actual["/"] == LoopNames(
        "/", "/vdp_plant", "/koopman_lifter", "/relay_esc", "/state", "/cost", "/theta"
    )
    assert actual["/rig"] == LoopNames(
        "/rig", lifter="/rig/lifter", state="/rig/state", cost="/rig/cost"
    )


def test_the_state_of_a_rig_that_is_no_ros_node_belongs_to_the_loop_of_its_namespace():
    rig = {"/a_copy": STATE, "/state": STATE, "/rig/state": STATE}
    actual = find_loops({"/lifter": {"/cost": COST}}, rig)
    assert actual == {
        "/": LoopNames("/", lifter="/lifter", cost="/cost", state="/state"),
        "/rig": LoopNames("/rig", state="/rig/state"),
    }


def test_where_a_commander_passes_on_what_a_controller_says_theta_is_what_the_rig_gets():
    commander = {"/zz_commander": {"/theta": THETA}}
    alone = find_loops(commander, {})["/"]
    assert (alone.controller, alone.theta) == ("/zz_commander", "/theta")
    both = find_loops({**commander, "/esc": {"/verify/theta": THETA}}, {}, managed={"/esc"})["/"]
    assert (both.controller, both.theta) == ("/esc", "/theta")


def test_a_guard_is_not_the_controller_although_the_rig_listens_to_its_theta():
    esc = {"/esc": {"/theta_asked": THETA}}
    own = {"/guard": {"/theta": THETA, "/guard/state": GUARD}, **esc}
    loop = find_loops(own, {}, managed={"/esc", "/guard"})["/"]
    assert (loop.controller, loop.guard, loop.theta) == ("/esc", "/guard", "/theta")
    foreign = {"/guard": {"/rig/theta": "std_msgs/msg/Float64", "/guard/state": GUARD}}
    loop = find_loops({**foreign, "/esc": {"/theta": THETA}}, {}, managed={"/esc", "/guard"})["/"]
    assert (loop.controller, loop.guard, loop.theta) == ("/esc", "/guard", "/theta")


def test_a_node_that_has_gone_keeps_its_place_as_long_as_its_loop_has_another():
    expected = KnownLoops()
    assert expected.update({"/": LoopNames("/", lifter="/lifter", cost="/cost")}, 0.0)
    assert expected.update({"/": LoopNames("/", controller="/esc")}, 1.0)
    both = LoopNames("/", lifter="/lifter", controller="/esc", cost="/cost")
    assert expected.loops == {"/": both}
    assert not expected.update({"/": LoopNames("/", controller="/esc")}, 100.0)
    assert not expected.update({}, 100.0 + GONE)  # it may be restarted
    assert expected.update({"/rig": LoopNames("/rig")}, 100.1 + GONE)
    assert expected.loops == {"/rig": LoopNames("/rig")}
    assert expected.update({"/": LoopNames("/", cost="/cost")}, 200.0)
    assert expected.loops == {"/": LoopNames("/", cost="/cost")}
