"""What viewers are configured with is there: fields of messages, names of nodes."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml
from rosbags.typesys import get_types_from_msg

SRC = Path(__file__).parents[2] / "src"
LAYOUTS = SRC / "koop_bringup" / "layouts"
TYPES = {
    "state": "MeasuredState",
    "cost": "Cost",
    "theta": "ControlInput",
    "ground_truth": "PlantTruth",
}
STATES = 2


def fields_of(topic):
    """Return {field: whether it is an array} as another library reads the definition."""
    text = (SRC / "koop_msgs" / "msg" / f"{TYPES[topic]}.msg").read_text()
    name = f"koop_msgs/msg/{TYPES[topic]}"
    _, fields = get_types_from_msg(text, name)[name]
    return {field: kind.name in ("ARRAY", "SEQUENCE") for field, (kind, _) in fields}


def assert_path_exists(topic, field):
    name, index = re.fullmatch(r"(\w+)(?:\[(\d+)\])?", field).groups()
    fields = fields_of(topic)
    assert name in fields, f"/{topic} has no field {name}"
    assert fields[name] == (index is not None), f"/{topic}.{field}"
    assert int(index or 0) < STATES


def plotjuggler_paths():
    root = ElementTree.parse(LAYOUTS / "plotjuggler.xml").getroot()
    for curve in root.iter("curve"):
        xy = [curve.get("curve_x"), curve.get("curve_y")]
        yield from xy if all(xy) else [curve.get("name")]


def foxglove_panels():
    return json.loads((LAYOUTS / "foxglove.json").read_text())["configById"]


def foxglove_paths():
    for panel in foxglove_panels().values():
        for path in [*panel.get("paths", ()), *filter(None, [panel.get("xAxisPath")])]:
            yield path["value"]


@pytest.mark.parametrize(
    ("paths", "pattern"),
    [(plotjuggler_paths, r"/(\w+)/(.+)"), (foxglove_paths, r"/(\w+)\.(.+)")],
    ids=["PlotJuggler", "Foxglove"],
)
def test_every_path_is_a_field_and_every_topic_is_shown(paths, pattern):
    actual = [re.fullmatch(pattern, path).groups() for path in paths()]
    assert {topic for topic, _ in actual} == set(TYPES)
    for topic, field in actual:
        assert_path_exists(topic, field)
    assert {("state", "x[0]"), ("cost", "r"), ("theta", "theta[0]")} <= set(actual)


def test_no_layout_goes_by_stamps_which_a_rig_need_not_set():
    for panel in foxglove_panels().values():
        for path in [*panel.get("paths", ()), *filter(None, [panel.get("xAxisPath")])]:
            assert path["timestampMethod"] == "receiveTime", path
    plugins = ElementTree.parse(LAYOUTS / "plotjuggler.xml").getroot().find("Plugins")
    by_stamp = {"use_header_stamp": "value", "parameters": "use_timestamp"}
    by_stamp["foxglove_client"] = "use_timestamp"
    for plugin in plugins:
        actual = [item.get(by_stamp[item.tag]) for item in plugin if item.tag in by_stamp]
        assert actual in (["false"], ["0"]), plugin.get("ID")


def test_every_plotjuggler_source_takes_every_topic():
    for plugin in ElementTree.parse(LAYOUTS / "plotjuggler.xml").getroot().find("Plugins"):
        lists = [item.get("value") for item in plugin.iter("selected_topics")]
        lists += [item.get("selected_topics") for item in plugin.iter("parameters")]
        topics = {topic for text in lists for topic in text.split(";")}
        topics |= {item.get("name") for item in plugin.iter("topic")}
        assert topics == {f"/{topic}" for topic in TYPES}, plugin.get("ID")


def test_every_foxglove_panel_stands_in_the_layout():
    panels = foxglove_panels()
    shown = []

    def walk(node):
        if isinstance(node, str):
            shown.append(node)
        else:
            walk(node["first"])
            walk(node["second"])

    for tab in panels["Tab!main"]["tabs"]:
        walk(tab["layout"])
    assert sorted(shown) == sorted(set(panels) - {"Tab!main"})
    for name in shown:  # Foxglove and Lichtblick each read a title of their own
        titles = [panels[name][f"{viewer}PanelTitle"] for viewer in ("foxglove", "lichtblick")]
        assert titles[0] == titles[1], name


def test_the_layouts_are_installed():
    from ament_index_python.packages import get_package_share_path

    for name in ("plotjuggler.xml", "foxglove.json"):
        assert (get_package_share_path("koop_bringup") / "layouts" / name).is_file()


@pytest.mark.parametrize("namespace", ["", "/fleet/loop_1"])
def test_the_aggregator_puts_every_node_into_one_group(namespace):
    text = (SRC / "koop_bringup" / "config" / "aggregator.yaml").read_text()
    settings = yaml.safe_load(text)["analyzers"]["ros__parameters"]
    groups = {name: group for name, group in settings.items() if isinstance(group, dict)}
    for group in groups.values():  # the aggregator ends at a parameter of another type
        assert type(group["timeout"]) is float
        assert type(group.get("num_items", 0)) is int
    for node in ("vdp_plant", "koopman_lifter", "relay_esc", "recorder", "player"):
        name = f"{namespace}/{node}"
        matching = [g for g in groups.values() if any(part in name for part in g["contains"])]
        assert len(matching) == 1, name
