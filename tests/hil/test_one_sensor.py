"""A rig of one sensor and one knob, both plain numbers: from its recording to the closed loop."""

import time

import numpy as np
import pytest
from koop_msgs.msg import ControlInput
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from std_msgs.msg import Float64

from koop_lab.cli.main import main
from koop_loop.training import trajectory_kernel
from vdp_plant import dynamics
from vdp_plant.config import PlantConfig

DT = 0.02
PLANT = PlantConfig(dt=DT)
STORE = get_typestore(Stores.ROS2_JAZZY)
KIND = "std_msgs/msg/Float64"
REST = 60.0  # [s] of theta in the recording
WATCHED = 30.0  # [s] at the end of the run


def record(path):
    """Write what a recorder of another make would: the sensor, and the knob now and then."""
    rng = np.random.default_rng(0)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        pressure, knob = (
            writer.add_connection(topic, KIND, typestore=STORE) for topic in ("/pressure", "/knob")
        )
        states, p = np.empty((2, round(REST / DT))), PLANT.params()
        at = 10**18
        for theta in rng.uniform(-5.0, 2.0, 40):
            message = STORE.types[KIND](data=float(theta))
            writer.write(knob, at, STORE.serialize_cdr(message, KIND))
            assert trajectory_kernel(p, *rng.uniform(-3, 3, 2), theta, states)
            for value in states[0]:
                at += round(DT * 1e9)
                message = STORE.types[KIND](data=float(value))
                writer.write(pressure, at, STORE.serialize_cdr(message, KIND))


@pytest.mark.slow
def test_a_rig_of_one_sensor_is_damped(start, probe, tmp_path, capfd):
    record(tmp_path / "recorded")
    model = tmp_path / "model.npz"
    what = ["--measured", "/pressure:data", "--command", "/knob:data", "--dt", str(DT)]
    learn = ["train", str(tmp_path / "recorded"), "--contrast", "--delays", "8"]
    assert main([*learn, *what, "--out", str(model)]) == 0, capfd.readouterr()
    assert "strong_and_weak_by theta" in capfd.readouterr().out
    start(
        "koopman_lifter", measured="/pressure:data", model=model, dt=DT,
        omega_l=0.6,
    )  # fmt: skip
    start("relay_esc", theta_initial=-1.0, step_size=DT / 15.0, tau_f=3.0)
    turned = probe.collect(ControlInput, "theta")
    sensor = probe.publisher(Float64, "/pressure")
    params, steps = PLANT.params(), round(120.0 / DT)
    x, y = dynamics.initial_state(3)
    theta = np.full(steps, -1.0)
    applied = -1.0
    for k in range(steps):  # the rig waits for the knob: the machine may be as slow as it likes
        heard, due = len(turned), 0.0

        def answered():
            # best effort: a sample is lost while the lifter does not know of the sensor yet, and
            # one that a busy machine delays is too old
            nonlocal due
            if time.monotonic() > due:
                due = time.monotonic() + 1.0
                sensor.publish(Float64(data=dynamics.measure(params, k, x, y)[0]))  # noqa: B023
            return len(turned) > heard  # noqa: B023

        probe.spin_until(answered, f"an answer to sample {k}")
        (theta[k],) = turned[-1].theta
        x, y, applied = dynamics.advance(params, k, x, y, applied, theta[k])
    error = np.abs(theta[-round(WATCHED / DT) :] - PLANT.theta_star)
    assert error.mean() < 0.8  # it began 2 from the optimum
