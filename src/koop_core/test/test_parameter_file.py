"""Parameter files, against rcl's own reading of them."""

from collections import namedtuple

import pytest

from koop_core.config.parameter import ConfigError
from koop_core.config.parameter_file import read, shared_names, write

KEYS = (
    "/**", "**", "/*", "/**/node", "**/node", "/*/node", "/node", "node", "/a/node", "a/node",
    "/a/*", "/a/**", "/**/b/node", "/a/*/node", "/a/**/node", "/b/node", "/**/other",
)  # fmt: skip
VALUES = (
    "yes", "y", "N", "tRue", "1e-3", "1E5", "1.0e3", ".5", "5.", "1_000", "0x10", "010", "08", "-3",
    "on", "'1'", "1:30", "2026-01-01", ".inf", "-.inf", "lifted", "''", "/x/y", "[1.0, 2.5]",
)  # fmt: skip


def section(key, values):
    return f'"{key}": {{ros__parameters: {{{values}}}}}\n'


@pytest.fixture
def rcl(monkeypatch):
    """What rclpy gives to the node `node` in a namespace, from a file."""
    import rclpy

    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")

    def values(file, namespace=""):
        context = rclpy.Context()
        context.init(args=["--ros-args", "--params-file", str(file)])
        node = rclpy.create_node(
            "node", context=context, namespace=namespace, start_parameter_services=False,
            automatically_declare_parameters_from_overrides=True,
        )  # fmt: skip
        actual = {name: item.value for name, item in node.get_parameters_by_prefix("").items()}
        node.destroy_node()
        context.shutdown()
        for name in ("use_sim_time", "start_type_description_service"):
            actual.pop(name, None)
        return {name: list(v) if hasattr(v, "tolist") else v for name, v in actual.items()}

    return values


@pytest.mark.ros
def test_a_file_says_to_a_node_what_rcl_says(tmp_path, rcl):
    """One parameter a key and a value, in one file, for the nodes of three namespaces."""
    file = tmp_path / "params.yaml"
    names = {f"k{i}" for i in range(len(KEYS))} | {f"v{i}" for i in range(len(VALUES))}
    text = "".join(section(key, f"k{i}: 1, last: {i}") for i, key in enumerate(KEYS))
    text += "/a: {node: {ros__parameters: {nested: 1, of: {one: 2, more: {deep: 3}}}}}\n"
    text += section("/**/node", "y: 1, on: 2, true: 3, 5: 4")
    names |= {"y", "on", "true", "5"}
    text += "/**/values/node:\n  ros__parameters:\n"
    text += "".join(f"    v{i}: {value}\n" for i, value in enumerate(VALUES))
    file.write_text(text)
    for namespace in ("", "/a", "/a/b", "/values"):
        expected = rcl(file, namespace)
        assert read(file).values(f"{namespace}/node", names | {"last"}) == expected
        assert len(expected) > 5


def test_what_all_nodes_are_told_is_taken_by_those_that_have_it(tmp_path):
    file = tmp_path / "params.yaml"
    file.write_text(section("/**", "gain: 1, robot_description: x, use_sim_time: true"))
    assert read(file).values("/node", {"gain"}) == {"gain": 1, "use_sim_time": True}
    file.write_text(section("/**/node", "robot_description: x"))
    assert read(file).values("/node", {"gain"}) == {"robot_description": "x"}


def test_the_namespace_of_a_file_is_the_one_that_it_names(tmp_path):
    file = tmp_path / "params.yaml"
    Case = namedtuple("Case", "keys namespace")
    for case in (
        Case(["/**/node", "/other"], "/"),
        Case(["node"], "/"),
        Case(["/rig/one/node", "/rig/two/another"], "/rig/one"),
    ):
        file.write_text("".join(section(key, "gain: 1") for key in case.keys))
        assert read(file).namespace_of({"node"}) == case.namespace
    file.write_text(section("/b/node", "gain: 1") + section("/a/node", "gain: 1"))
    with pytest.raises(ConfigError, match="several loops, in the namespaces /a, /b: keep"):
        read(file).namespace_of({"node"})


def test_a_file_for_another_namespace_is_refused(tmp_path):
    file = tmp_path / "params.yaml"
    file.write_text(section("/**", "gain: 1") + section("node", "gain: 2"))
    reference = {"node": {"gain"}, "other": {"gain"}}
    assert read(file).values_of(reference) == {"node": {"gain": 2}, "other": {"gain": 1}}
    with pytest.raises(
        ConfigError, match=r"has no parameters for /a/node, /a/other; it has /\*\*, /node"
    ):
        read(file).values_of(reference, "/a")
    file.write_text(section("/**", "gain: 1"))
    assert read(file).values_of(reference, "/a")["node"] == {"gain": 1}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1]", "is not a ROS 2 parameter file"),
        ("node: 3", "'/node' has no ros__parameters"),
        ("a: {node: 3}", "'/a/node' has no ros__parameters"),
        ("node: {ros__parameters: 3}", "ros__parameters of '/node' is not a mapping"),
        ("node: [", "cannot be read as YAML"),
        ("[1, 2]: 3", "a key is not a name"),
        ("node: !!python/object/apply:os.system ['true']", "cannot be read as YAML"),
    ],
)
def test_what_is_not_a_parameter_file_is_refused(tmp_path, text, message):
    file = tmp_path / "params.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=r"params\.yaml: ") as caught:
        read(file)
    assert message in str(caught.value)


def test_written_values_are_read_in_any_namespace(tmp_path):
    file = tmp_path / "params.yaml"
    values = {"gain": 1e-7, "name": "on", "list": [1.0, 2.0], "flag": True, "text": "1e3"}
    values["again"] = values["list"]
    write({"node": values}, file)
    assert "&" not in file.read_text()  # rcl refuses aliases
    assert read(file).values("/some/where/node", set()) == values


def test_a_file_that_was_cut_off_anywhere_is_refused(tmp_path):
    # failed before: without its last section a loop started, and nobody guarded the rig
    file = tmp_path / "loop.yaml"
    write({"relay_esc": {"dwell": 1.0}, "koop_guard": {"rearms": 2}}, file)
    whole = file.read_text()
    assert len(read(file).sections) == 2
    for length in range(len(whole.rstrip())):
        file.write_text(whole[:length])
        with pytest.raises(ConfigError):
            read(file)


def test_a_section_that_was_meant_for_a_node_and_is_not_its_own_is_refused(tmp_path):
    file = tmp_path / "params.yaml"
    words = ["--ros-args", "--params-file", str(file)]
    file.write_text(section("/**/koopmn_lifter", "cost: raw") + section("/**/relay_esc", "a: 1"))
    assert shared_names(words, "/relay_esc") == set()
    with pytest.raises(ConfigError, match=r"did you mean '/\*\*/koopman_lifter'\?"):
        shared_names(words, "/koopman_lifter")
    file.write_text(section("/relay_esc", "a: 1") + section("/relay_esc_b", "a: 2"))
    assert shared_names(words, "/relay_esc") == set()
    with pytest.raises(ConfigError, match="'/relay_esc' is not /rig1/relay_esc: write"):
        shared_names(words, "/rig1/relay_esc")
