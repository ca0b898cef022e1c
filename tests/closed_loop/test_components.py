"""The nodes as a component container meets them: by name, with plain rclpy arguments."""

import time
from importlib.metadata import entry_points
from itertools import groupby

import pytest
from koop_msgs.msg import ControlInput
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter

GOLDEN = "recordings/golden/run"
NAMES = (
    "vdp_plant::PlantNode",
    "koopman_lifter::LifterNode",
    "relay_esc::EscNode",
    "koop_guard::GuardNode",
    "koop_bag::RecorderNode",
    "koop_bag::PlayerNode",
)


@pytest.fixture
def container(own_domain):
    """Load components as rclpy_components does."""
    context = Context()
    context.init(args=[])
    nodes = []

    def load(name, namespace="/box", remap=(), **parameters):
        (entry,) = entry_points(group="rclpy_components", name=name)
        options = {
            "context": context,
            "use_global_arguments": False,
            "namespace": namespace,
            "parameter_overrides": [Parameter(key, value=v) for key, v in parameters.items()],
            "cli_args": ["--ros-args", *(word for rule in remap for word in ("-r", rule))],
        }
        nodes.append(entry.load()(entry.name.partition("::")[2].lower(), **options))
        return nodes[-1]

    load.context = context
    yield load
    for node in nodes:
        node.close()
        node.destroy_node()
    context.try_shutdown()


def test_a_container_runs_the_whole_loop_in_one_process(container, tmp_path):
    recorder = container(NAMES[4], output=str(tmp_path / "run"))
    esc = container(NAMES[2], listeners="next recordernode")
    lifter = container(NAMES[1], listeners="next recordernode")
    plant = container(NAMES[0], listeners="next recordernode", pace="lockstep", duration=1.0)
    thetas = []
    plant.create_subscription(ControlInput, "theta", thetas.append, 1000)
    executor = EventsExecutor(context=container.context)
    loop = (recorder, esc, lifter, plant)
    for node in loop:
        executor.add_node(node)
    deadline = time.monotonic() + 120.0
    while plant.exit_code is None:
        executor.spin_once(timeout_sec=0.1)
        assert time.monotonic() < deadline, [node.lifecycle_state for node in loop]
    assert plant.exit_code == 0
    while not thetas or thetas[-1].step < 199:  # the plant may have heard the last one first
        executor.spin_once(timeout_sec=0.1)
        assert time.monotonic() < deadline
    # a busy machine asks again
    assert [step for step, _ in groupby(m.step for m in thetas)] == list(range(200))
    assert [node.get_fully_qualified_name() for node in loop] == [
        "/box/recordernode", "/box/escnode", "/box/lifternode", "/box/plantnode"
    ]  # fmt: skip
    while plant.active:  # who has finished says no more, though the process goes on
        executor.spin_once(timeout_sec=0.1)
        assert time.monotonic() < deadline
    assert recorder.exit_code is None
    for node in loop:
        executor.remove_node(node)
    executor.shutdown()


@pytest.mark.parametrize("name", NAMES)
def test_no_callback_for_a_qos_event_is_installed(container, tmp_path, name):
    chosen = {"RecorderNode": {"output": str(tmp_path / "run")}, "PlayerNode": {"bag": GOLDEN},
             "GuardNode": {"command": "/rig/theta:data"}}  # fmt: skip
    options = {"use_sim_time": True, **chosen.get(name.partition("::")[2], {})}
    node = container(name, autostart=False, **options)
    assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
    assert node.trigger_activate() == TransitionCallbackReturn.SUCCESS
    topics = {entity.topic_name for entity in [*node.publishers, *node.subscriptions]}
    assert {"/diagnostics", "/parameter_events", "/clock"} <= topics
    for entity in [*node.publishers, *node.subscriptions]:
        assert list(entity.event_handlers) == [], entity.topic_name


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("koopman_lifter::LifterNode", {"model": "/nowhere.npz"}),
        ("koop_bag::RecorderNode", {"topics": "state /a:no_msgs/msg/No"}),
        ("koop_bag::RecorderNode", {"output": "/proc/nowhere"}),
        ("koop_bag::PlayerNode", {"bag": "/nowhere"}),
        ("koop_bag::PlayerNode", {"bag": GOLDEN, "topics": "nothing"}),
    ],
)
def test_a_configure_that_fails_leaves_no_entity(container, tmp_path, name, parameters):
    if "RecorderNode" in name:
        parameters = {"output": str(tmp_path / "run"), **parameters}
    node = container(name, autostart=False, **parameters)

    def entities():
        kinds = (node.publishers, node.subscriptions, node.timers, node.services, node.clients)
        return [len(list(kind)) for kind in kinds]

    before = entities()
    for _ in range(2):
        assert node.trigger_configure() == TransitionCallbackReturn.FAILURE
        assert node.lifecycle_state == "unconfigured"
        assert entities() == before
    assert not list(tmp_path.iterdir())
