"""The sros2 policy says what the nodes do, and what koop starts stays on this machine."""

from xml.etree import ElementTree

from ament_index_python.packages import get_package_share_path

NODES = {"vdp_plant", "koopman_lifter", "relay_esc", "recorder"}


def allowed(kind, direction):
    """Return {node: names} of the policy."""
    file = get_package_share_path("koop_bringup") / "security" / "policy.xml"
    return {
        profile.get("node"): {
            item.text for group in profile.findall(kind) if group.get(direction) for item in group
        }
        for profile in ElementTree.parse(file).getroot().iter("profile")
    }


def test_every_node_has_its_own_permissions():
    assert set(allowed("topics", "publish")) == NODES


def test_only_the_controller_may_command_the_plant():
    publishers = allowed("topics", "publish")
    assert {node for node, topics in publishers.items() if "theta" in topics} == {"relay_esc"}
    assert not any("truth" in topics for node, topics in allowed("topics", "subscribe").items()
                   if node != "recorder")  # fmt: skip


def test_the_policy_covers_all_that_the_nodes_publish(start, probe, tmp_path):
    permitted = allowed("topics", "publish")
    for node in NODES:
        start(node, **({"output": tmp_path / "run"} if node == "recorder" else {}))

    def published(node):
        return {
            name.replace(f"/{node}/", "~/")
            for name, _ in probe.node.get_publisher_names_and_types_by_node(node, "/")
        }

    for node in NODES:
        probe.spin_until(
            lambda node=node: node in probe.node.get_node_names() and published(node), node
        )
        unknown = {
            name for name in published(node) if not {name, name.lstrip("/")} & permitted[node]
        }
        assert not unknown, node
