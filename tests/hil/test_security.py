"""The sros2 policy says what the nodes do, and what koop starts stays on this machine."""

from fnmatch import fnmatchcase
from xml.etree import ElementTree

from ament_index_python.packages import get_package_share_path
from koop_msgs.msg import Cost

NODES = {"vdp_plant", "koopman_lifter", "relay_esc", "koop_guard", "recorder"}
TWIN = "_koop_guard_twin"


def allowed(kind, direction):
    """Return {node: full names} of the policy."""
    file = get_package_share_path("koop_bringup") / "security" / "policy.xml"
    return {
        profile.get("node"): {
            full_name(item.text, profile.get("node"))
            for group in profile.findall(kind)
            if group.get(direction) == "ALLOW"
            for item in group
        }
        for profile in ElementTree.parse(file).getroot().iter("profile")
    }


def full_name(name, node):
    return (
        name if name[0] == "/" else name.replace("~", f"/{node}") if name[0] == "~" else f"/{name}"
    )


def test_every_node_has_its_own_permissions():
    assert set(allowed("topics", "publish")) == NODES | {TWIN}


def test_only_controller_and_guard_may_command():
    publishers = allowed("topics", "publish")
    commanders = {node for node, topics in publishers.items() if "/theta" in topics}
    assert commanders == {"relay_esc", "koop_guard", TWIN}
    subscribers = allowed("topics", "subscribe")
    heard = {node for node, topics in subscribers.items() if "/ground_truth" in topics}
    assert heard <= {"recorder"}


def test_the_policy_covers_all_that_the_nodes_say_hear_serve_and_ask(start, probe, tmp_path):
    start("recorder", output=tmp_path / "run")
    start("vdp_plant", publish_clock="true")
    constraint = "rms(state:x[0], 1 s) < 10"
    start("koopman_lifter", use_sim_time="true", constraint=constraint)
    start("relay_esc", "-r", "theta:=theta_asked", use_sim_time="true")
    rig = {"measured": "state:x[0]", "command": "theta:theta[0]", "constraint": constraint}
    start("koop_guard", dt=0.005, **rig)
    costs = probe.collect(Cost, "cost")
    probe.spin_until(lambda: costs, "the loop")
    nodes = NODES | {TWIN}
    probe.spin_until(lambda: set(probe.node.get_node_names()) >= nodes, "all nodes in the graph")
    heard = {"/state", "/cost", "/theta", "/ground_truth", "/clock", "/relay_esc/transition_event"}

    def names(question, node):
        ask = getattr(probe.node, f"get_{question}_names_and_types_by_node")
        return {name for name, _ in ask(node, "/")}

    probe.spin_until(lambda: heard <= names("subscriber", "recorder"), "the recorder")
    probe.spin_until(lambda: "/relay_esc/reset" in names("client", "koop_guard"), "the guard")
    for question, kind, direction in (
        ("publisher", "topics", "publish"),
        ("subscriber", "topics", "subscribe"),
        ("service", "services", "reply"),
        ("client", "services", "request"),
    ):
        permitted = allowed(kind, direction)
        for node in nodes:
            # the recorder also asks the probe of this test for its parameters
            live = {name for name in names(question, node) if not name.startswith("/probe/")}
            assert live or question == "client" or node == TWIN, (node, question)
            rules = permitted[node]
            unknown = {name for name in live if not any(fnmatchcase(name, r) for r in rules)}
            assert not unknown, (node, question)
