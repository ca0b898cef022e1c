"""An aircraft in turbulence, by JSBSim: a Cessna 172 whose roll autopilot has a gain to be found.

Theta is the derivative gain ``ap/roll-pid-kd`` of the model that comes with JSBSim (c172x; GPL, so
it is loaded from the installed wheel and nothing of it is copied). Too little of theta lets the
gusts roll the aircraft, too much lets the loop itself oscillate, all at once. More throttle is more
airspeed, which moves the optimum. The optimum depends on the step of 1/120 s, too.
"""

from __future__ import annotations

import argparse
import math
import os
import random
from typing import Any

from stand import Actuation, SimulatedRig, parse_rig, plant_of_others, start

STEP = 1.0 / 120.0  # [s]
FOOT = 0.3048  # [m]
GAIN = "ap/roll-pid-kd"
LOW, HIGH, START = 0.5, 60.0, 1.0  # of theta
ALTITUDE = 4000.0  # [ft]
BEFORE = 60.0  # [s] that are flown before the first sample
NOISE = 3e-4  # standard deviation of a gyroscope [rad/s]
NAMES = {
    "throttle": "fcs/throttle-cmd-norm",
    "turbulence": "atmosphere/turbulence/milspec/severity",
}
RATES = ("velocities/p-rad_sec", "velocities/q-rad_sec", "velocities/r-rad_sec")
ACCELERATIONS = tuple(f"accelerations/a-pilot-{axis}-ft_sec2" for axis in "xyz")
FLIGHT = {
    "propulsion/set-running": -1,  # all engines
    "fcs/mixture-cmd-norm": 0.87,
    NAMES["throttle"]: 0.8,
    "ap/altitude_setpoint": ALTITUDE,
    "ap/altitude_hold": 1,
    "ap/attitude_hold": 1,
    "ap/roll-pid-kp": 50.0,
    "atmosphere/turb-type": 3,  # Dryden's spectrum, by MIL-F-8785C
    "atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps": 25.0,
}


class Flight(SimulatedRig):
    """The aircraft, level and trimmed.

    Raises ValueError if JSBSim is not installed, or has no property that ``--at`` names.
    """

    dt, message, topics = STEP, "Imu", ("imu", "gain")

    def __init__(self, args: argparse.Namespace) -> None:
        os.environ["JSBSIM_DEBUG"] = "0"  # no banner
        jsbsim = plant_of_others("jsbsim")
        self.actuations = [Actuation(*start(args, START), LOW, HIGH)]
        self._noise = args.noise
        self._fdm = fdm = jsbsim.FGFDMExec(None)
        fdm.set_debug_level(0)
        if not fdm.load_model("c172x"):
            raise ValueError("this JSBSim has no c172x")
        fdm.set_dt(STEP)
        fdm.set_output_filename(0, os.devnull)  # the model's own log, in the folder of the caller
        for item in args.at:
            if not fdm.get_property_manager().hasNode(NAMES.get(item.name, item.name)):
                names = ", ".join(NAMES)
                raise ValueError(f"--at: JSBSim has no property {item.name!r}; there is {names}")
        fdm["ic/h-sl-ft"], fdm["ic/vc-kts"] = ALTITUDE, 90.0
        fdm["simulation/randomseed"] = args.seed
        fdm.run_ic()
        for name, value in FLIGHT.items():
            fdm[name] = value
        self.set("turbulence", args.turbulence)
        for _ in range(round(BEFORE / STEP)):
            self.advance(0.0, self.actuations[0].start)

    def measure(self, t: float, rng: random.Random) -> tuple[list[float], list[float]]:
        """Return rates [rad/s] and accelerations [m/s2]; the true rates and the airspeed [kt]."""
        rates = [self._fdm[name] for name in RATES]
        if not all(map(math.isfinite, rates)):
            raise ValueError(f"the aircraft was lost at t = {t:g} s")
        accelerations = [FOOT * self._fdm[name] for name in ACCELERATIONS]
        noisy = [rate + rng.gauss(0.0, self._noise) for rate in rates]
        return noisy + accelerations, [*rates, self._fdm["velocities/vc-kts"]]

    def advance(self, t: float, theta: float) -> None:
        """Fly one step."""
        self._fdm[GAIN] = theta
        self._fdm.run()

    def set(self, name: str, value: float) -> None:
        """Set a property, by JSBSim's name or by one of :data:`NAMES`."""
        self._fdm[NAMES.get(name, name)] = value


def register(rigs: Any) -> None:
    """Add it to the command line."""
    text = "an aircraft in turbulence (JSBSim's c172x): sensor_msgs/Imu, takes std_msgs/Float64"
    parser = parse_rig(rigs, "jsbsim", text, Flight)
    parser.add_argument(
        "--turbulence", type=float, default=3.0, help="severity, 0 (still air) to 7"
    )
    parser.add_argument("--noise", type=float, default=NOISE, help="of the gyroscopes [rad/s]")
