"""The rig around a plant of others: what it publishes is what the plant itself does."""

import importlib.util
import os
import random
import subprocess
import sys
from argparse import Namespace

import numpy as np
import pytest
from koop_msgs.msg import PlantTruth
from sensor_msgs.msg import Imu
from std_msgs.msg import Float64

from koop_hil import installed
from koop_hil.run import run
from koop_hil.scenario import find, read

RIGS = installed("rigs")
sys.path[:0] = [str(RIGS)]

flight_needed = pytest.mark.skipif(
    importlib.util.find_spec("jsbsim") is None, reason="JSBSim is not installed"
)


def rig(*words, **more):
    """Run a rig until it has ended."""
    return subprocess.run(
        [sys.executable, str(RIGS / "rig.py"), *map(str, words)], capture_output=True, text=True,
        timeout=240, env={**os.environ, **more},
    )  # fmt: skip


def test_a_plant_that_is_not_installed_says_how_to_get_it(tmp_path):
    (tmp_path / "jsbsim.py").write_text("raise ImportError('none here')")
    done = rig("jsbsim", PYTHONPATH=str(tmp_path))
    get = "pip install --no-deps -r requirements/plants.txt"
    assert (done.returncode, done.stderr) == (1, f"rig: none here: {get}\n")


@flight_needed
@pytest.mark.ros
def test_what_an_aircraft_publishes_is_its_true_state_and_it_takes_the_gain(probe):
    heard, truths = probe.collect(Imu, "/imu"), probe.collect(PlantTruth, "/ground_truth")
    gain = probe.node.create_publisher(Float64, "/gain", 1)
    words = ["--noise", "0", "--duration", "2", "--jitter", "0", "--truth", "--at", "1:throttle=0"]
    process = subprocess.Popen(
        [sys.executable, str(RIGS / "rig.py"), "jsbsim", *words], stdout=subprocess.PIPE, text=True
    )
    try:
        probe.spin_until(lambda: gain.get_subscription_count() and heard, "the aircraft")

        def ended():
            gain.publish(Float64(data=99.0))  # again: the aircraft may not know the publisher yet
            return process.poll() is not None

        probe.spin_until(ended, "its end")
        begin, end = process.communicate()[0].splitlines()
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 0
    assert (begin, end.partition(" in ")[0]) == ("connected", "240 steps")
    probe.spin_until(lambda: len(heard) >= 240 and truths[-1].step == 239, "the end")
    stamps = np.array([m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in heard])
    assert np.allclose(np.diff(stamps), 1 / 120, atol=1e-6)
    rates = np.array([[getattr(m.angular_velocity, axis) for axis in "xyz"] for m in heard])
    expected = [m.step for m in truths]  # the first ones may not have been heard
    assert len(expected) > 100
    assert np.array_equal(rates[expected], [m.x[:3] for m in truths])
    assert (rates.std(axis=0) > 1e-3).all()
    applied = [m.theta_applied[0] for m in truths]
    assert (applied[0], applied[-1]) == (1.0, 60.0)  # within its stroke


@flight_needed
def test_the_roll_rate_has_a_smallest_value_a_cliff_beyond_it_and_moves_with_the_throttle():
    from flight import STEP, Flight

    def roll_rate(theta, throttle=0.7):
        flight = Flight(Namespace(theta_initial=[theta], seed=1, turbulence=3.0, noise=0.0, at=[]))
        flight.set("throttle", throttle)
        rates = []
        for k in range(round(60.0 / STEP)):
            flight.advance(k * STEP, theta)
            rates.append(flight.measure(k * STEP, random.Random(0))[1][0])
        return 1e3 * np.std(rates)  # [mrad/s]

    slow, best, beyond = (roll_rate(theta) for theta in (0.5, 14.0, 30.0))
    assert 2.0 < best < 5.0  # a published 3.4; of another minute of gusts
    assert slow > 3.0 * best
    assert beyond > 6.0 * best
    assert roll_rate(14.0, 1.0) > 10.0 * best


@flight_needed
def test_a_property_that_jsbsim_does_not_have_is_a_line():
    done = rig("jsbsim", "--at", "3:trottle=1")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == (
        "rig: --at: JSBSim has no property 'trottle'; there is throttle, turbulence\n"
    )


def test_a_change_without_a_time_is_a_line():
    done = rig("jsbsim", "--at", "throttle=1")
    assert done.returncode == 2
    assert "'throttle=1': write T:NAME=VALUE" in done.stderr.splitlines()[-1]


@pytest.mark.parametrize(
    ("scenario", "package", "name"),
    [("rig-jsbsim-gusts", "jsbsim", "JSBSim"), ("rig-inverter", "dpsimpy", "DPsim")],
)
def test_a_scenario_is_skipped_without_the_plant_of_others(
    scenario, package, name, tmp_path, monkeypatch
):
    monkeypatch.setitem(sys.modules, package, None)
    verdict = run(read(find(scenario)), tmp_path)
    assert verdict.skipped.startswith(f"{name} is not installed: pip install")
    assert not verdict.passed
