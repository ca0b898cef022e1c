"""The arrows between packages, rooms and files point one way, and only nodes know ROS."""

import ast
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

SRC = Path(__file__).parents[2] / "src"
FLOORS = (  # a package imports only from the floors below its own
    {"koop_core"},
    {"koop_node"},
    {"vdp_plant", "koopman_lifter", "relay_esc", "koop_guard", "koop_bag"},
    {"koop_loop", "koop_view"},
    {"koop_identify", "koop_bringup"},
    {"koop_tune"},
    {"koop_commission", "koop_lab"},
    {"koop_hil", "koop_bench", "koop_study"},
)
PACKAGES = set().union(*FLOORS)
ALGORITHMS = {"vdp_plant", "koopman_lifter", "relay_esc", "koop_guard"}
PURE = {"koop_core", "koop_loop", "koop_identify", "koop_tune"}
BAG_WITHOUT_ROS = tuple(
    f"koop_bag.{name}" for name in ("bag.", "cdr.", "mcap.", "errors", "recorder.config")
)
ROS = {"rclpy", "koop_msgs", "std_msgs", "std_srvs", "rosgraph_msgs", "builtin_interfaces",
       "diagnostic_msgs", "lifecycle_msgs", "rcl_interfaces", "ament_index_python"}  # fmt: skip


@cache
def modules(package):
    """Return {dotted name: file} of a package."""
    actual = {}
    for path in sorted((SRC / package / package).rglob("*.py")):
        parts = path.relative_to(SRC / package).with_suffix("").parts
        actual[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return actual


ALL = {name: path for package in sorted(PACKAGES) for name, path in modules(package).items()}


@cache
def imports(path):
    """Return the names of the modules that a file imports."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            full = {f"{node.module}.{alias.name}" for alias in node.names}
            names |= full & ALL.keys() or {node.module}
            names |= {node.module} if full - ALL.keys() else set()
    return names


def needs_ros(module):
    """Return whether a module is a node, or one of a node's folder."""
    return "node" in module.split(".") or module.endswith(".executable")


def assert_no_circle(graph):
    """Fail with the circle, if there is one."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


@pytest.mark.parametrize("package", sorted(PACKAGES))
def test_a_package_imports_only_from_the_floors_below(package):
    floor = next(i for i, names in enumerate(FLOORS) if package in names)
    below = set().union(*FLOORS[:floor])
    assert modules(package)
    for path in modules(package).values():
        imported = {name.split(".")[0] for name in imports(path)} & PACKAGES
        assert imported <= below | {package}, path


@pytest.mark.parametrize("package", sorted(PACKAGES))
def test_the_rooms_of_a_package_import_one_another_one_way(package):
    def room(module):
        return module.split(".")[1] if "." in module else ""

    graph = {}
    for module, path in modules(package).items():
        others = {room(name) for name in imports(path) if name.split(".")[0] == package}
        graph.setdefault(room(module), set()).update(others - {room(module), ""})
    assert_no_circle(graph)


def test_no_files_import_each_other_in_a_circle():
    assert_no_circle({name: imports(path) & ALL.keys() - {name} for name, path in ALL.items()})


def test_every_package_of_the_workspace_has_its_floor():
    assert {path.parent.name for path in SRC.glob("*/setup.py")} == PACKAGES


@pytest.mark.parametrize("package", sorted(ALGORITHMS | PURE))
def test_a_pure_module_imports_neither_ros_nor_what_needs_it(package):
    allowed = PURE | ALGORITHMS | {"koop_bag"}
    for module, path in modules(package).items():
        if package in ALGORITHMS and needs_ros(module):
            continue
        for name in imports(path):
            top = name.split(".")[0]
            assert top not in ROS, path
            assert top not in PACKAGES or top in allowed, path
            assert top not in ALGORITHMS or not needs_ros(name), path
            if top == "koop_bag" and name.count("."):
                assert name.startswith(BAG_WITHOUT_ROS), path


def test_the_commands_load_no_ros_before_they_need_it():
    for path in modules("koop_lab").values():
        top = ast.parse(path.read_text()).body
        heads = [n for n in top if isinstance(n, ast.Import | ast.ImportFrom)]
        names = {a.name for n in heads for a in n.names} | {getattr(n, "module", "") for n in heads}
        assert not {name.split(".")[0] for name in names if name} & ROS, path
