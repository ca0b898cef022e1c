"""What users read about parameters: complete, in 100 columns, and read back as it was meant."""

from dataclasses import asdict, dataclass

import pytest

from koop_core.config import parameter_file
from koop_core.config.describe import WIDTH, help_text
from koop_core.config.describe import parameter_file as annotated
from koop_core.config.parameter import NodeConfig, Settings, parameter


@dataclass(frozen=True)
class Example(Settings):
    gain: float = parameter(1e-6, "a gain", unit="1/s", low=0.0, high=10.0)
    count: int = parameter(3, "a count", low=1)
    free: float = parameter(0.005 / 15.0, "a length without limits", unit="m")
    mode: str = parameter("on", "a mode", choices=("on", "1e3"))
    limits: tuple[float, ...] = parameter((0.0, 1.0), "limits " * 30, low=-1.0, high=1.0)
    none: tuple[float, ...] = parameter((), "more limits")
    where: str = parameter("", "a place: somewhere # here", read_only=True)


def with_mode(value):
    """Return an example whose mode has another default."""

    @dataclass(frozen=True)
    class Other(Example):
        mode: str = parameter(value, "a mode", choices=("on", "1e3"))

    return Other


def test_help_says_default_range_unit_and_meaning_of_every_parameter():
    lines = help_text("ros2 run a b", "Does much.", (Example, NodeConfig)).splitlines()
    assert max(map(len, lines)) <= WIDTH
    assert lines[:3] == [
        "usage: ros2 run a b --ros-args [-p NAME:=VALUE] [--params-file FILE] [-r FROM:=TO]",
        "",
        "Does much.",
    ]
    for text in (
        "  gain = 1.0e-06: number, 0 to 10 1/s",
        "      a gain",
        "  count = 3: whole number, at least 1",
        "  free = 0.0003333333333333333: number [m]",
        "  mode = 'on': one of on, 1e3",
        "  limits = [0.0, 1.0]: list of numbers, -1 to 1",
        "  none = []: list of numbers",
        "  where = '': text, fixed while the node runs",
        "  autostart = true: true or false, fixed while the node runs",
        "  priority = 0: whole number, 0 to 99, fixed while the node runs",
    ):
        assert text in lines


@pytest.mark.parametrize("mode", ["on", "1e3"])
def test_an_annotated_file_is_read_back_as_the_defaults(tmp_path, mode):
    text = annotated({"one": (with_mode(mode), NodeConfig), "two": (NodeConfig,)})
    assert max(map(len, text.splitlines())) <= WIDTH
    file = tmp_path / "rig.yaml"
    file.write_text(text)
    actual = parameter_file.read(file).values_of({"one": (), "two": ()})
    assert actual["two"] == asdict(NodeConfig())
    wanted = asdict(Example(mode=mode)) | asdict(NodeConfig())
    del wanted["none"]  # of an empty list ROS cannot tell the type
    assert actual["one"] == wanted | {"limits": [0.0, 1.0]}
    assert {name: type(value) for name, value in actual["one"].items()} == {
        name: list if name == "limits" else type(value) for name, value in wanted.items()
    }
    assert "    # none: []\n" in text
