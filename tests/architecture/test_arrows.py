"""The arrows between the packages point one way, and only nodes know ROS."""

import ast
from pathlib import Path

import pytest

SRC = Path(__file__).parents[2] / "src"
ALGORITHMS = {"vdp_plant", "koopman_lifter", "relay_esc"}
LEAVES = {"koop_hil", "koop_study"}
PACKAGES = (
    {"koop_node", "koop_loop", "koop_bag", "koop_lab", "koop_bringup", "koop_view"}
    | ALGORITHMS
    | LEAVES
)
MAY_IMPORT = {
    "koop_node": set(),
    "vdp_plant": {"koop_node"},
    "koopman_lifter": {"koop_node"},
    "relay_esc": {"koop_node"},
    "koop_bag": {"koop_node"},
    "koop_view": {"koop_node", "koop_bag"},
    "koop_loop": {"koop_node"} | ALGORITHMS,
    "koop_bringup": {"koop_node", "koop_loop", "koop_bag"} | ALGORITHMS,
    "koop_lab": PACKAGES - LEAVES,
    "koop_hil": PACKAGES - LEAVES - {"koop_bringup"},
    "koop_study": PACKAGES - LEAVES - {"koop_bringup"},
}
PURE_GLUE = {
    f"koop_node.{name}" for name in ("arrival", "config", "errors", "fields", "kernels", "start")
}
ROS = {"rclpy", "koop_msgs", "std_msgs", "std_srvs", "rosgraph_msgs", "builtin_interfaces",
       "diagnostic_msgs", "lifecycle_msgs", "rcl_interfaces", "ament_index_python"}  # fmt: skip


def modules(package):
    return sorted((SRC / package / package).rglob("*.py"))


def node_modules(package):
    """Return `node.py`, or what is in the folder `node`."""
    return [path for path in modules(package) if "node" in (path.stem, path.parent.name)]


def imports(path, top_level_only=False):
    """Return the names of the modules that a file imports."""
    tree = ast.parse(path.read_text())
    nodes = tree.body if top_level_only else ast.walk(tree)
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module


@pytest.mark.parametrize("package", sorted(PACKAGES))
def test_a_package_imports_only_what_lies_below_it(package):
    assert modules(package)
    for path in modules(package):
        imported = {name.split(".")[0] for name in imports(path)} & PACKAGES
        assert imported <= MAY_IMPORT[package] | {package}, path


@pytest.mark.parametrize("package", ["vdp_plant", "koopman_lifter", "relay_esc"])
def test_only_the_node_of_an_algorithm_imports_ros(package):
    for path in modules(package):
        known = {name.split(".")[0] for name in imports(path)} & ROS
        glue = {name for name in imports(path) if name.startswith("koop_node")}
        if path not in node_modules(package):
            assert not known, path
            assert glue <= PURE_GLUE, path


def test_the_offline_commands_import_no_ros():
    for path in modules("koop_lab"):
        if path.name not in ("bare_chain.py", "commander.py"):  # processes of their own
            top = {name.split(".")[0] for name in imports(path, top_level_only=True)}
            assert not top & ROS, path
