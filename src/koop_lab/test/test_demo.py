"""What ``koop demo`` makes of its options and its parameter file, before it starts anything."""

import pytest

from koop_core.config.parameter import ConfigError
from koop_lab.cli.main import parser
from koop_lab.commands.demo import read_options


@pytest.fixture
def choose(tmp_path):
    """Return the parameters that a file and options describe."""

    def choose(text, *options):
        file = tmp_path / "my.yaml"
        file.write_text(text)
        return read_options(
            parser("demo").parse_args(["demo", "--params-file", str(file), *options])
        )

    return choose


MINE = """
vdp_plant: {ros__parameters: {pace: scaled, time_scale: 4, duration: 30, seed: 5, listeners: it}}
recorder: {ros__parameters: {keep_size: 5.0, output: /nowhere}}
"""


def test_the_file_wins_over_the_usual_values_of_the_command(choose):
    parameters, recorder = choose(MINE)
    pace = parameters.pace
    assert (pace.pace, pace.time_scale, pace.duration) == ("scaled", 4.0, 30.0)
    assert parameters.plant.seed == 5
    assert recorder.keep_size == 5.0
    usual, _ = choose("relay_esc: {ros__parameters: {dwell: 3.0}}")
    assert (usual.pace.pace, usual.pace.duration) == ("lockstep", 2500.0)


def test_an_option_wins_over_the_file(choose):
    parameters, _ = choose(MINE, "--pace", "lockstep", "--duration", "20", "--seed", "6")
    assert (parameters.pace.pace, parameters.pace.duration) == ("lockstep", 20.0)
    assert parameters.plant.seed == 6
    parameters, _ = choose(MINE, "--pace", "2.5")
    assert (parameters.pace.pace, parameters.pace.time_scale) == ("scaled", 2.5)
    with pytest.raises(ConfigError, match="must be realtime, lockstep or a number"):
        choose(MINE, "--pace", "slow")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("recorder: {ros__parameters: {keep_size: -1}}", "recorder: keep_size = -1: must"),
        ("recorder: {ros__parameters: {speed: 3}}", "recorder: unknown parameter 'speed'"),
        ("vdp_plant: {ros__parameters: {duration: 0}}", "--duration must cover at least two steps"),
    ],
)
def test_what_a_node_cannot_use_is_refused(choose, text, message):
    with pytest.raises(ConfigError, match=message):
        choose(text)
