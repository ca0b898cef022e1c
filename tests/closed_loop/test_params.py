"""The file of ``koop params`` in the real nodes."""

from dataclasses import asdict

from koop_bag.recorder.parameters import ParameterCollector
from koop_bringup.plan import plan
from koop_lab.cli.main import main
from koop_tune.result.parameter_text import KNOWN

NODES = ("relay_esc", "koopman_lifter", "vdp_plant", "recorder")
LEFT_OUT = {"listeners", "autostart", "initial_state"}  # of how it is started; an empty list


def test_the_file_of_koop_params_gives_every_node_its_defaults(start, probe, tmp_path, capsys):
    file = tmp_path / "rig.yaml"
    assert main(["params", *NODES]) == 0
    file.write_text(capsys.readouterr().out)
    for node in NODES:
        start(node, "--params-file", str(file), "-p", "autostart:=false")
    asked = ParameterCollector(probe.node, "/")
    probe.spin_until(
        lambda: asked.look() and {f"/{node}" for node in NODES} <= set(asked.values), "the nodes"
    )
    asked.close()
    for node in NODES:
        values = {k: v for cls in KNOWN[node] for k, v in asdict(cls()).items()}
        wanted = {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}
        actual = asked.values[f"/{node}"]
        assert set(wanted) - LEFT_OUT <= set(actual)
        for name in set(wanted) - LEFT_OUT:
            assert (actual[name], type(actual[name])) == (wanted[name], type(wanted[name])), name


def test_the_file_for_a_rig_feeds_the_launch(tmp_path, capsys):
    assert main(["params"]) == 0
    file = tmp_path / "rig.yaml"
    file.write_text(capsys.readouterr().out)
    planned = plan({"params": str(file), "record": "true"})
    assert planned.rig
    assert [node.name for node in planned.nodes] == ["recorder", "relay_esc", "koopman_lifter"]


def test_an_unknown_node_is_said_in_one_line(capsys):
    assert main(["params", "relay_ecs"]) == 2
    error = capsys.readouterr().err
    assert "unknown node 'relay_ecs': did you mean 'relay_esc'?" in error
    assert error.count("\n") == 1
