"""What a launch decides before it starts a node: which values count, what is refused."""

import shutil
import sys

import pytest

from koop_bringup.plan import (
    ARGUMENTS,
    TRANSPORTS,
    plan,
    refuse_other_arguments,
    return_time,
)
from koop_core.config.parameter import ConfigError
from koop_loop.parameters import read
from koopman_lifter.config import shipped_model

MINE = """
/**: {ros__parameters: {robot_description: x, dt: 0.005, use_sim_time: false}}
vdp_plant: {ros__parameters: {pace: lockstep, duration: 20, seed: 7, listeners: next recorder}}
koopman_lifter: {ros__parameters: {cost: raw}}
recorder: {ros__parameters: {queue: 77}}
"""


@pytest.fixture
def mine(tmp_path):
    """Write a parameter file; return the argument that names it."""
    file = tmp_path / "my.yaml"

    def write(text=MINE):
        file.write_text(text)
        return {"params": str(file)}

    return write


def names(planned):
    return [node.name for node in planned.nodes]


def test_without_arguments_nothing_is_given_and_the_nodes_take_their_own_defaults():
    planned = plan({argument.name: "" for argument in ARGUMENTS})
    assert names(planned) == ["relay_esc", "koopman_lifter", "vdp_plant"]
    assert not any(planned.parameters.values())


def test_the_file_wins_over_defaults_and_only_a_given_argument_wins_over_the_file(mine):
    planned = plan({**mine(), "record": "true", "seed": "3", "pace": "", "duration": ""})
    assert names(planned) == ["recorder", "relay_esc", "koopman_lifter", "vdp_plant"]
    options = planned.parameters
    shared = {"use_sim_time": False, "listeners": "next recorder"}
    assert options["vdp_plant"] == {
        **shared, "dt": 0.005, "pace": "lockstep", "duration": 20, "seed": 3
    }  # fmt: skip
    assert options["koopman_lifter"] == {**shared, "dt": 0.005, "cost": "raw"}
    assert options["recorder"] == {
        "use_sim_time": False, "queue": 77
    }  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "listeners"),
    [
        ({}, None),
        ({"record": "true"}, "next recorder"),
        ({"record": "true", "plant": "false"}, None),
    ],
)
def test_the_nodes_wait_for_the_recorder_that_there_is(mine, arguments, listeners):
    planned = plan({**mine(), **arguments})
    loop = {
        options.get("listeners")
        for name, options in planned.parameters.items()
        if name != "recorder"
    }
    assert loop == {listeners}
    assert any("'listeners' is not used" in note for note in planned.notes) == (
        "plant" not in arguments
    )


@pytest.mark.parametrize(
    ("command", "remaps"),
    [("/rig/theta:data", ()), ("/theta:theta[0]", ("relay_esc:theta:=theta_asked",))],
)
def test_a_guard_alone_commands_the_rig(mine, command, remaps):
    file = mine(
        "relay_esc: {ros__parameters: {theta_max: 3.0}}\n"
        f"koop_guard: {{ros__parameters: {{command: '{command}', theta_rate: 0.5}}}}\n"
    )
    planned = plan({**file, "record": "true"})
    assert names(planned) == ["recorder", "koop_guard", "relay_esc", "koopman_lifter"]
    assert planned.remaps == remaps
    assert planned.parameters["relay_esc"]["listeners"] == "koop_guard"
    assert return_time(planned.parameters) == 20.0  # from -5 to 5
    assert names(plan({**file, "plant": "true"})) == ["relay_esc", "koopman_lifter", "vdp_plant"]
    assert not planned.notes
    guard = "koop_guard: {ros__parameters: {command: '/rig/theta:data'}}\n"
    with pytest.raises(ConfigError, match="dt differs"):
        plan(mine(guard.replace("'}}", "', dt: 0.1}}")))
    two = "relay_esc: {ros__parameters: {theta_initial: [1.0, 2.0]}}"
    with pytest.raises(ConfigError, match="knobs differ: the command of koop_guard 1, relay_esc 2"):
        plan(mine(guard + two))
    for wide in ("theta_max: 3.1", "theta_min: -1.0, theta_max: 2.0, widest: [-1.0, 3.1]"):
        esc = f"relay_esc: {{ros__parameters: {{{wide}}}}}"
        with pytest.raises(ConfigError, match=r"3\.1\], of which koop_guard allows \[-5, 3\]"):
            plan(mine(guard.replace("'}}", "', theta_max: 3.0}}") + esc))
    planned = plan(
        mine(guard.replace(":data", ":a,b").replace("'}}", "', theta_rate: [1.0, 0.5]}}") + two)
    )
    assert return_time(planned.parameters) == 20.0  # of the slower one


def test_a_rig_takes_the_place_of_the_plant(mine):
    planned = plan({**mine(), "plant": "False", "record": "true"})
    assert planned.rig
    assert names(planned) == ["recorder", "relay_esc", "koopman_lifter"]
    assert (planned.environment, plan({}).environment) == ({TRANSPORTS: "UDPv4"}, {})


def test_the_file_says_whether_the_plant_is_simulated_unless_an_argument_does(mine):
    of_all = "/**: {ros__parameters: {use_sim_time: false}}\n"
    tuning = mine(f"{of_all}relay_esc: {{ros__parameters: {{dwell: 3.0}}}}")
    planned = plan(tuning)
    assert planned.rig
    assert "no section for vdp_plant: the loop runs on the rig" in planned.notes[0]
    assert not plan({**tuning, "plant": "true"}).rig
    assert (
        plan(mine("rig: {ros__parameters: {command: ''}}\n/**: {ros__parameters: {dt: 0.005}}"))
        .notes[0]
        .partition(": ")[2]
        == "has no section koop_guard: whatever fails, the rig keeps the last theta"
    )
    assert not plan(
        mine("/**/vdp_plant: {ros__parameters: {}}\n/**: {ros__parameters: {dt: 0.005}}")
    ).rig
    assert not plan({}).rig


def test_the_rig_s_own_program_is_started_where_the_file_names_one(mine):
    text = f"rig: {{ros__parameters: {{command: {sys.executable} -m 'a rig' --fast}}}}\n"
    tuning = "relay_esc: {ros__parameters: {dwell: 3.0}}"
    planned = plan(mine(text + tuning))
    assert planned.program == (sys.executable, "-m", "a rig", "--fast")
    assert names(planned) == ["relay_esc", "koopman_lifter"]
    assert plan(mine(tuning)).program == ()
    with pytest.raises(ConfigError, match="names the simulated plant and the rig's own program"):
        plan(mine(text + MINE))
    for command, problem in (
        ("nowhere --now", "no program 'nowhere' found"),
        ("'\"sh'", "No closing quotation"),
        ("3", "expected str, got 3"),
    ):
        with pytest.raises(ConfigError, match=f"rig: command.*{problem}"):
            plan(mine(f"rig: {{ros__parameters: {{command: {command}}}}}\n{tuning}"))


def test_one_dt_for_all_nodes(mine):
    with pytest.raises(ConfigError, match=r"dt differs: koopman_lifter 0.01, vdp_plant 0.005 s"):
        plan({**mine("koopman_lifter: {ros__parameters: {dt: 0.01}}"), "plant": "true"})


def test_a_namespace_may_begin_with_an_underscore():
    assert plan({"namespace": "_rig/a_1"}).namespace == "/_rig/a_1"


def test_a_loop_in_a_namespace_takes_what_the_file_says_to_it(mine):
    text = "".join(
        f"/{n}/relay_esc: {{ros__parameters: {{dwell: {n[-1]}.0}}}}\n" for n in ("r1", "r2")
    )
    planned = plan({**mine(text), "namespace": "r2"})
    assert planned.namespace == "/r2"
    assert planned.parameters["relay_esc"]["dwell"] == 2.0
    with pytest.raises(
        ConfigError, match=r"has no parameters for /r3/relay_esc, .* has /.., /vdp_plant,"
    ):
        plan({**mine(), "namespace": "r3"})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"duration": "abc"}, "duration:=abc: must be a number"),
        ({"duration": "-1"}, "vdp_plant: duration = -1: must be 0 to "),
        ({"seed": "1.5"}, "seed:=1.5: must be a whole number"),
        ({"pace": "foo"}, "pace = 'foo': must be realtime, lockstep or a number"),
        ({"cost": "cooked"}, "cost = 'cooked': must be one of "),
        ({"plant": "maybe"}, "plant:=maybe: must be true or false"),
        ({"record": "2"}, "record:=2: must be true or false"),
        ({"namespace": "a-b"}, "namespace:=a-b: is not a namespace"),
        (
            {"plant": "false", "pace": "lockstep"},
            "pace:=lockstep: needs the simulated plant",
        ),
        ({"output": "x"}, "output:=x: needs record:=true"),
        ({"model": "/nowhere.npz"}, "/nowhere.npz: cannot be read"),
        ({"params": "/nowhere.yaml"}, "/nowhere.yaml: cannot be read"),
    ],
)
def test_a_bad_argument_is_refused_before_a_node_starts(arguments, message):
    with pytest.raises(ValueError, match=message):
        plan(arguments)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("vdp_plant: {ros__parameters: {mass: 1.0}}", "vdp_plant: unknown parameter 'mass'"),
        ("recorder: {ros__parameters: {queue: 1}}", "queue = 1: must be 10 to"),
        (
            "another: {ros__parameters: {gain: 1}}",
            "has no parameters for /recorder, .* it has /another",
        ),
        ("{}", "it has no section"),
    ],
)
def test_a_bad_file_is_refused_before_a_node_starts(mine, text, message):
    with pytest.raises(ConfigError, match=message):
        plan({**mine(text), "record": "true"})


def test_a_folder_that_holds_a_recording_is_refused(mine, tmp_path):
    (tmp_path / "bag").mkdir()
    text = f"recorder: {{ros__parameters: {{output: {tmp_path}}}}}"
    for options in ({"output": str(tmp_path)}, mine(text)):
        with pytest.raises(ConfigError, match="holds a recording already: choose another output"):
            plan({"record": "true", **options})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("/**/koopmn_lifter: {ros__parameters: {cost: raw}}", "mean '/\\*\\*/koopman_lifter'"),
        ("plant: {ros__parameters: {seed: 1}}", "did you mean '/vdp_plant'"),
        (
            "/relay_esc: {ros__parameters: {dwell: 2.0}}",
            "'/relay_esc' is not /rig1/relay_esc",
        ),
    ],
)
def test_a_section_that_would_be_ignored_beside_valid_ones_is_refused(mine, text, message):
    valid = "/**/recorder: {ros__parameters: {queue: 77}}\n"
    with pytest.raises(ConfigError, match=message):
        plan({**mine(valid + text), "namespace": "rig1", "record": "true", "plant": "true"})


def test_a_misspelt_guard_does_not_leave_the_rig_without_one(mine):
    text = "/**/relay_esc: {ros__parameters: {dwell: 2.0}}\n/**/koop_gaurd: {ros__parameters: {}}"
    with pytest.raises(ConfigError, match="did you mean '/\\*\\*/koop_guard'"):
        plan(mine(text))


def test_sections_of_other_programs_are_not_minded(mine):
    text = "/**/driver: {ros__parameters: {gain: 1.0}}\n/**/camera: {ros__parameters: {a: 1}}\n"
    assert plan({**mine(text + MINE)}).parameters["relay_esc"] == {"use_sim_time": False}


def test_only_the_lifted_cost_needs_a_model_that_fits(mine):
    options = mine("/**: {ros__parameters: {dt: 0.01, model: /nowhere.npz}}")
    assert plan({**options, "cost": "raw"}).parameters["koopman_lifter"]["cost"] == "raw"
    with pytest.raises(ValueError, match=r"/nowhere.npz: cannot be read"):
        plan(options)
    with pytest.raises(ValueError, match=r"trained at dt = 0.005 s, this node runs at dt = 0.01"):
        plan(mine("/**: {ros__parameters: {dt: 0.01}}"))


def test_a_model_beside_the_file_is_found_wherever_the_folder_is(mine, tmp_path, monkeypatch):
    options = mine("koopman_lifter: {ros__parameters: {model: own.npz}}")
    shutil.copyfile(shipped_model(), tmp_path / "own.npz")
    monkeypatch.chdir("/")
    assert plan(options).parameters["koopman_lifter"]["model"] == str(tmp_path / "own.npz")
    assert read(options["params"])["koopman_lifter"]["model"] == str(tmp_path / "own.npz")
    (tmp_path / "own.npz").unlink()
    with pytest.raises(ValueError, match=r"own.npz: cannot be read"):
        plan(options)


def test_what_a_launch_gives_to_all_nodes_reaches_those_that_have_it(mine):
    planned = plan({**mine(), "pace": "2.5"}, {"seed": 5, "dwell": 3.0, "robot_description": "x"})
    assert planned.parameters["vdp_plant"]["seed"] == 7  # of the file
    assert planned.parameters["relay_esc"]["dwell"] == 3.0
    assert "seed" not in planned.parameters["relay_esc"]
    assert plan({}, {"seed": 5}).parameters["vdp_plant"] == {"seed": 5}
    pace = {name: planned.parameters["vdp_plant"][name] for name in ("pace", "time_scale")}
    assert pace == {"pace": "scaled", "time_scale": 2.5}


def test_an_argument_that_the_launch_does_not_have_is_refused():
    refuse_other_arguments(["duration:=3", "sigterm_timeout:=20", "of_the_file_around:=2"])
    with pytest.raises(ConfigError, match="unknown argument 'durations': did you mean"):
        refuse_other_arguments(["durations:=3"])
