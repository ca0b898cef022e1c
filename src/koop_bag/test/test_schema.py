"""Definitions and hashes against `rosbags`, which brings its own copies and its own hashing."""

import pytest
from koop_bag_messages import LOOP
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from koop_bag.cdr.schema import load_schema
from koop_bag.errors import BagError

COMMON = (
    "sensor_msgs/msg/JointState",
    "std_msgs/msg/Float64MultiArray",
    "diagnostic_msgs/msg/DiagnosticArray",
    "rcl_interfaces/msg/ParameterEvent",
)


@pytest.mark.parametrize("name", COMMON)
def test_a_definition_holds_all_that_it_needs_and_its_hash_is_right(name):
    store = get_typestore(Stores.EMPTY)
    schema = load_schema(name)
    for part in schema.text.split("=" * 80 + "\n"):
        head, _, body = part.partition("\n")
        is_root = not head.startswith("MSG: ")
        text, full = (part, name) if is_root else (body, head[5:].replace("/", "/msg/"))
        store.register(get_types_from_msg(text, full))
    # EMPTY knows no type but those just registered: a missing dependency fails to hash
    assert schema.type_hash == store.hash_rihs01(name)
    assert schema.type_hash == get_typestore(Stores.ROS2_JAZZY).hash_rihs01(name)


@pytest.mark.parametrize("name", LOOP.values())
def test_the_hash_of_our_own_messages_is_that_of_an_independent_implementation(name, messages):
    assert load_schema(name).type_hash == messages.store.hash_rihs01(name)


def test_a_dependency_that_is_used_several_times_stands_once():
    text = load_schema("rcl_interfaces/ParameterEvent").text
    names = [line for line in text.splitlines() if line.startswith("MSG: ")]
    assert sorted(names) == [
        "MSG: builtin_interfaces/Time",
        "MSG: rcl_interfaces/Parameter",
        "MSG: rcl_interfaces/ParameterValue",
    ]


def test_a_type_that_is_not_installed_is_named_with_the_remedy():
    with pytest.raises(BagError, match=r"nowhere_msgs/msg/Thing.*source the workspace"):
        load_schema("nowhere_msgs/msg/Thing")
    with pytest.raises(BagError, match="pkg/msg/Type"):
        load_schema("Thing")


def test_a_package_without_type_descriptions_gets_an_empty_hash(tmp_path, monkeypatch):
    folder = tmp_path / "share" / "own_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Outer.msg").write_text("Inner inner # own_msgs/Other\nint32 A=3\nstring<=5[<=2] s")
    (folder / "Inner.msg").write_text("float64[3] x")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    schema = load_schema("own_msgs/Outer")
    assert schema.type_hash == ""
    assert schema.text.endswith("] s\n" + "=" * 80 + "\nMSG: own_msgs/Inner\nfloat64[3] x")


def test_dependencies_stand_in_the_order_of_rosbag2(tmp_path, monkeypatch):
    """By name, each followed by its own (rosbag2_cpp/local_message_definition_source.cpp)."""
    texts = {
        "own_msgs/Outer": "Zeta z\nAlpha[3] a\nodd_msgs/Beta b\nown_msgs/Alpha again\n",
        "own_msgs/Zeta": "Mid m\r\n",
        "own_msgs/Mid": "bool x\n",
        "own_msgs/Alpha": "odd_msgs/Beta b\nbool x\n",
        "odd_msgs/Beta": "# Zeta z\nbool x\n",
    }
    for name, text in texts.items():
        package, kind = name.split("/")
        folder = tmp_path / "share" / package / "msg"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{kind}.msg").write_bytes(text.encode())
    order = ["odd_msgs/Beta", "own_msgs/Alpha", "own_msgs/Zeta", "own_msgs/Mid"]
    expected = texts["own_msgs/Outer"]
    for name in order:
        expected += "\n" + "=" * 80 + f"\nMSG: {name}\n{texts[name]}"
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert load_schema("own_msgs/Outer").text == expected
