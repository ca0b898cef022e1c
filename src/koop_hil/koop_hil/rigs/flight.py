"""An aircraft in turbulence, by JSBSim: a Cessna 172 whose roll autopilot has a gain to be found.

Theta is the derivative gain ``ap/roll-pid-kd`` of the model that comes with JSBSim (c172x; GPL, so
it is loaded from the installed wheel and nothing of it is copied). Attitude and altitude hold are
on. The controller of the model is stepped with the simulation: its optimum depends on the step of
1/120 s. Too little of theta lets the gusts roll the aircraft, too much lets the loop itself
oscillate, all at once. More throttle is more airspeed, which moves the optimum.
"""

from __future__ import annotations

import argparse
import ctypes
import math
import os
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

from stand import INSTALL, Knob, Schedule, Stand, change

STEP = 1.0 / 120.0  # [s]
FOOT = 0.3048  # [m]
GAIN = "ap/roll-pid-kd"
LOW, HIGH, START = 0.5, 60.0, 1.0  # of theta
ALTITUDE = 4000.0  # [ft]
SPEED = 90.0  # at first [kt]
BEFORE = 60.0  # [s] that are flown before the first sample
THROTTLE = 0.8
SEVERITY = 3.0
NOISE = 3e-4  # standard deviation of a gyroscope [rad/s]
NAMES = {
    "throttle": "fcs/throttle-cmd-norm",
    "turbulence": "atmosphere/turbulence/milspec/severity",
}
RATES = ("velocities/p-rad_sec", "velocities/q-rad_sec", "velocities/r-rad_sec")
ACCELERATIONS = tuple(f"accelerations/a-pilot-{axis}-ft_sec2" for axis in "xyz")
AIRSPEED = "velocities/vc-kts"


def register(rigs: Any, common: argparse.ArgumentParser) -> None:
    """Add it to the command line."""
    parser = rigs.add_parser(
        "jsbsim", parents=[common],
        help="an aircraft in turbulence (JSBSim's c172x); publishes sensor_msgs/Imu on /imu, takes "
        "std_msgs/Float64 on /gain",
    )  # fmt: skip
    parser.add_argument(
        "--turbulence", type=float, default=SEVERITY, help="severity, 0 (still air) to 7"
    )
    parser.add_argument("--noise", type=float, default=NOISE, help="of the gyroscopes [rad/s]")
    parser.add_argument(
        "--at", action="append", type=change, default=[], metavar="T:NAME=VALUE",
        help="at this time [s] set throttle, turbulence or any property of JSBSim; repeatable",
    )  # fmt: skip
    parser.add_argument("--log", default="", metavar="FILE", help="JSBSim's own log, as CSV")
    parser.set_defaults(run=run)


class Flight:
    """The aircraft, level and trimmed.

    Parameters
    ----------
    throttle, turbulence : float
        At the start; the airspeed follows.
    seed : int
        Of the turbulence.
    theta : float
        At the start.

    Raises
    ------
    ValueError
        If JSBSim is not installed or has no such aircraft.
    """

    def __init__(
        self, throttle: float, turbulence: float, seed: int, theta: float, log: str = ""
    ) -> None:
        try:
            import jsbsim
        except ImportError as error:
            raise ValueError(f"{error}: {INSTALL}") from None
        self.fdm = fdm = _quietly(lambda: jsbsim.FGFDMExec(None))
        fdm.set_debug_level(0)
        if not _quietly(lambda: fdm.load_model("c172x")):
            raise ValueError("this JSBSim has no c172x")
        fdm.set_dt(STEP)
        fdm.set_output_filename(0, os.devnull)  # the model's own log, in the folder of the caller
        for name, value in {
            "ic/h-sl-ft": ALTITUDE,
            "ic/vc-kts": SPEED,
            "simulation/randomseed": seed,
        }.items():
            fdm[name] = value
        if log:
            self._write(log)
        fdm.run_ic()
        for name, value in {
            "propulsion/set-running": -1,  # all engines
            "fcs/mixture-cmd-norm": 0.87,
            NAMES["throttle"]: throttle,
            "ap/altitude_setpoint": ALTITUDE,
            "ap/altitude_hold": 1,
            "ap/attitude_hold": 1,
            "ap/roll-pid-kp": 50.0,
            "atmosphere/turb-type": 3,  # Dryden's spectrum, by MIL-F-8785C
            "atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps": 25.0,
            NAMES["turbulence"]: turbulence,
        }.items():
            fdm[name] = value
        for _ in range(round(BEFORE / STEP)):
            self.advance(theta)

    def _write(self, log: str) -> None:
        """Let JSBSim write a log of its own: time, theta and rates of every step."""
        names = "".join(f"<property>{name}</property>" for name in (GAIN, *RATES))
        kind = f'name="{Path(log).resolve()}" type="CSV" rate="{round(1.0 / STEP)}"'
        with NamedTemporaryFile("w", suffix=".xml") as file:
            file.write(f'<?xml version="1.0"?>\n<output {kind}>{names}</output>\n')
            file.flush()
            self.fdm.set_output_directive(file.name)

    def check(self, name: str) -> None:
        """Raise ValueError if JSBSim does not have a property."""
        if not self.fdm.get_property_manager().hasNode(NAMES.get(name, name)):
            raise ValueError(f"--at: JSBSim has no property {name!r}; there is {', '.join(NAMES)}")

    def set(self, name: str, value: float) -> None:
        """Set a property, by JSBSim's name or by one of :data:`NAMES`."""
        self.fdm[NAMES.get(name, name)] = value

    def advance(self, theta: float) -> None:
        """Fly one step."""
        self.fdm[GAIN] = theta
        self.fdm.run()

    def rates(self) -> list[float]:
        """Return roll, pitch and yaw rate [rad/s]."""
        return [self.fdm[name] for name in RATES]

    def measured(self) -> list[float]:
        """Return the rates, then the acceleration in three axes [m/s2]."""
        return self.rates() + [FOOT * self.fdm[name] for name in ACCELERATIONS]


def run(args: argparse.Namespace, begin: Callable[[Stand], Stand]) -> None:
    """Fly.

    Raises
    ------
    ValueError
        If JSBSim is not installed, a property is not known, or the aircraft is lost.
    """
    start = START if args.theta_initial is None else args.theta_initial
    flight = Flight(THROTTLE, args.turbulence, args.seed, start, args.log)
    for item in args.at:
        flight.check(item.name)
    from wire import Imu, Wire, imu

    wire = Wire(args.state or "imu", args.theta or "gain", Imu, imu, False, args.truth)
    stand = begin(Stand(args, wire, STEP, Knob(start, LOW, HIGH)))
    schedule = Schedule(args.at)
    while True:
        for item in schedule.due(stand.t):
            flight.set(item.name, item.value)
        true = flight.measured()
        if not all(map(math.isfinite, true)):
            raise ValueError(f"the aircraft was lost at t = {stand.t:g} s")
        said = [v + stand.rng.gauss(0.0, args.noise) for v in true[:3]] + true[3:]
        theta = stand.exchange(said, [*true[:3], flight.fdm[AIRSPEED]])
        if theta is None:
            return
        flight.advance(theta)


def _quietly(call: Callable[[], Any]) -> Any:
    """Call a function without the banner that it prints, through Python or from C++."""
    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        return call()
    finally:
        sys.stdout.flush()
        ctypes.CDLL(None).fflush(None)
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)
