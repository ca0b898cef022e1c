"""Rigs around plants of others: what they publish is what the plant itself says."""

import csv
import importlib.util
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from sensor_msgs.msg import Imu
from std_msgs.msg import Float64

from koop_hil import installed
from koop_hil.run import run
from koop_hil.scenario import find, read

RIGS = installed("rigs")
sys.path[:0] = [str(RIGS), str(Path(__file__).parent / "fmu")]

from absorber import amplitude  # noqa: E402
from build import build  # noqa: E402

fmu_needed = pytest.mark.skipif(
    importlib.util.find_spec("fmpy") is None, reason="FMPy is not installed"
)
flight_needed = pytest.mark.skipif(
    importlib.util.find_spec("jsbsim") is None, reason="JSBSim is not installed"
)


def rig(*words, **more):
    """Run a rig until it has ended."""
    return subprocess.run(
        [sys.executable, str(RIGS / "rig.py"), *map(str, words)], capture_output=True, text=True,
        timeout=60, env={**os.environ, **more},
    )  # fmt: skip


@pytest.fixture(scope="module")
def absorber(tmp_path_factory):
    """Build the FMU."""
    path = tmp_path_factory.mktemp("fmu") / "absorber.fmu"
    build(path)
    return str(path)


@fmu_needed
@pytest.mark.parametrize("exchange", [False, True])
def test_an_fmu_swings_as_its_equations_do(absorber, exchange):
    from fmu import Model
    from stand import Change

    dt, seen = 0.02, []
    model = Model(absorber, "tuning", ["mass.x", "absorber.x"], exchange, [Change(0, "force", 2.0)])

    def exchanged(t, x):
        seen.append((t, *x))
        if t > 160.0 - dt / 2:
            return None
        return 0.9 if t < 80.0 else 1.1  # not the start value: it is set while it runs

    model.run(dt, 1.0, exchanged)
    t, mass, _ = np.array(seen).T
    assert np.allclose(t, dt * np.arange(1, t.size + 1))  # every sample once
    for tuning, end in ((0.9, 80.0), (1.1, 160.0)):
        last = (t > end - 4.0) & (t <= end)
        found = math.sqrt(2.0) * mass[last].std()  # of whole periods
        assert found == pytest.approx(2.0 * amplitude(tuning), rel=0.01)  # e^-5 is left
    assert amplitude(1.0) < 0.5 * min(amplitude(0.9), amplitude(1.1))  # there is something to seek


@fmu_needed
@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["none.fmu", "--input", "a", "--outputs", "b"], "none.fmu: there is no such FMU"),
        ([__file__, "--input", "a", "--outputs", "b"], "is not an FMU: "),
        (["FMU", "--input", "tunig", "--outputs", "mass.x"], "no variable 'tunig'; there is mass"),
        (["FMU", "--input", "mass.v", "--outputs", "mass.x"], "'mass.v' cannot be set while it runs"
         "; there is tuning, force"),
        (["FMU", "--input", "tuning", "--outputs", "mode"], "'mode' is not one real number"),
        (["FMU", "--input", "tuning", "--outputs", "mass.x", "--at", "3:force"], "TIME:NAME=VALUE"),
        (["FMU", "--input", "tuning", "--outputs", "mass.x", "--at", "3:F=1"], "no variable 'F'"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_an_fmu_is_a_line(absorber, words, message):
    words = [absorber if word == "FMU" else word for word in words]
    done = rig("fmu", *words, "--dt", "0.02")
    assert done.returncode in (1, 2)
    assert message in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("missing", "words"),
    [
        ("jsbsim", ["jsbsim"]),
        ("fmpy", ["fmu", __file__, "--input", "a", "--outputs", "b", "--dt", "1"]),
    ],
)
def test_a_plant_that_is_not_installed_says_how_to_get_it(missing, words, tmp_path):
    (tmp_path / f"{missing}.py").write_text("raise ImportError('none here')")
    done = rig(*words, PYTHONPATH=str(tmp_path))
    get = "pip install --no-deps -r requirements/plants.txt"
    assert (done.returncode, done.stderr) == (1, f"rig: none here: {get}\n")


@pytest.fixture
def flying(own_domain, tmp_path):
    """Start the aircraft; its own log is beside."""
    running = []

    def start(*words):
        command = [sys.executable, str(RIGS / "rig.py"), "jsbsim", *map(str, words)]
        running.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=tmp_path))
        return running[0]

    yield start
    for process in running:
        process.kill()
        process.communicate()


@flight_needed
@pytest.mark.ros
def test_what_an_aircraft_publishes_is_what_jsbsim_logs(flying, probe, tmp_path):
    log = tmp_path / "log.csv"
    heard = probe.collect(Imu, "/imu")
    told = probe.node.create_publisher(Float64, "/gain", 1)
    process = flying(
        "--noise", 0, "--log", log, "--duration", 3, "--jitter", 0, "--at", "2:throttle=0"
    )
    probe.spin_until(lambda: told.get_subscription_count() and heard, "the aircraft")

    def ended():
        told.publish(Float64(data=99.0))  # again: the aircraft may not know the publisher yet
        return process.poll() is not None

    probe.spin_until(ended, "its end")
    assert process.returncode == 0
    probe.spin_until(lambda: len(heard) >= 360, "the last sample")
    with log.open() as file:
        names, *rows = csv.reader(file)
    table = np.array(rows, float).T
    own = {name.rpartition("/")[2]: column for name, column in zip(names, table, strict=True)}
    stamps = np.array([m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in heard])
    assert np.allclose(np.diff(stamps), 1 / 120, atol=1e-6)
    begin = own["Time"].size - len(heard)
    for axis, name in zip("xyz", ("p-rad_sec", "q-rad_sec", "r-rad_sec"), strict=True):
        published = np.array([getattr(m.angular_velocity, axis) for m in heard])
        assert np.allclose(published, own[name][begin - 1 : -1], atol=1e-12)
        assert published.std() > 1e-3
    assert (own["roll-pid-kd"][1], own["roll-pid-kd"][-1]) == (1.0, 60.0)  # within its stroke


@flight_needed
def test_the_roll_rate_has_a_smallest_value_a_cliff_beyond_it_and_moves_with_the_throttle():
    from flight import STEP, Flight

    def roll_rate(theta, throttle):
        flight, found = Flight(throttle, 3.0, 1, theta), []
        for _ in range(round(60.0 / STEP)):
            flight.advance(theta)
            found.append(flight.rates()[0])
        return 1e3 * np.std(found)  # [mrad/s]

    slow, best, beyond = (roll_rate(theta, 0.7) for theta in (0.5, 14.0, 30.0))
    assert 2.0 < best < 5.0  # a published 3.4; of another minute of gusts
    assert slow > 3.0 * best
    assert beyond > 6.0 * best
    assert roll_rate(14.0, 1.0) > 10.0 * best


@flight_needed
@pytest.mark.ros
def test_a_flight_tells_only_its_beginning_and_its_end(own_domain):
    done = rig("jsbsim", "--readers", 0, "--duration", 0.1)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("connected\n12 steps in ")


@fmu_needed
@pytest.mark.ros
def test_an_fmu_tells_only_its_beginning_and_its_end(own_domain, absorber):
    words = ["--input", "tuning", "--outputs", "mass.x", "--dt", 0.02, "--model-exchange"]
    done = rig("fmu", absorber, *words, "--readers", 0, "--duration", 0.2)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("connected\n10 steps in ")


@flight_needed
def test_a_property_that_jsbsim_does_not_have_is_a_line():
    done = rig("jsbsim", "--at", "3:trottle=1")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == (
        "rig: --at: JSBSim has no property 'trottle'; there is throttle, turbulence\n"
    )


def test_a_scenario_with_an_aircraft_is_skipped_where_there_is_none(tmp_path, monkeypatch):
    monkeypatch.setattr("koop_hil.run.find_spec", lambda name: None)
    verdict = run(read(find("rig-jsbsim")), tmp_path)
    assert verdict.skipped.startswith("JSBSim is not installed: pip install")
    assert not verdict.passed
