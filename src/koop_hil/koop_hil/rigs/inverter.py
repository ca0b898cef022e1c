"""A grid-following inverter on a weak line, by DPsim: noise of the grid shakes its power.

Theta is the proportional gain of its power loop: too little lets the power swing slowly, too much
excites a fast mode. That of the phase-locked loop, ``kp_pll``, is a second knob; the two are
coupled. The other gains are of DPsim's 400 V, 10 kVA example, whose line is shorter. ``--at`` sets
``p_ref`` [W], which moves the optimum.
"""

from __future__ import annotations

import argparse
import cmath
import math
import random
import tempfile
from typing import Any

from stand import Actuation, SimulatedRig, parse_rig, plant_of_others, start

DT, STEPS = 1e-3, 5  # between two samples [s]; DPsim's steps within: another number, another plant
OMEGA, VOLTAGE, POWER = 2.0 * math.pi * 50.0, 400.0, 10e3  # [rad/s], [V], [W]
KI, CURRENT = 0.2, (0.25, 1.0)  # integral gains; of the current loop
FILTER = (2e-3, 10e-6, 0.2)  # [H], [F], [Ohm]
RESISTANCE, INDUCTANCE = 0.3, 15e-3  # of the line [Ohm], [H]
GRID = ((0.005, 0.02), (0.05, 0.5))  # noise of its magnitude [1] and angle [rad]; their memory [s]
TRIP = 100e3  # power at which its protection would have opened [W]
NOISE = 0.005  # of the sensors [kW], [kvar]


class Inverter(SimulatedRig):
    """Inverter, line and grid; one that has tripped is replaced by a new one.

    DPsim's memory grows by 18 bytes a step, 0.3 GB in an hour of the rig's time. Raises ValueError
    if DPsim is not installed, or ``--at`` names what it does not have.
    """

    dt, message, topics = DT, "JointState", ("inverter", "kp_power", "kp_pll")

    def __init__(self, args: argparse.Namespace) -> None:
        self._dp = dpsimpy = plant_of_others("dpsimpy")
        dpsimpy.Logger.set_log_dir(tempfile.gettempdir())  # not in the folder of the caller
        self._theta, self._power = tuple(start(args, 0.06, 0.16)), POWER
        strokes = zip(self._theta, (0.04, 0.06), (0.23, 0.4), strict=True)
        self.actuations = [Actuation(*stroke) for stroke in strokes]
        for item in args.at:
            if item.name != "p_ref":
                raise ValueError(f"--at: inverter has no {item.name!r}; there is p_ref")
        self._random, self._grid = random.Random(args.seed + 1), [0.0, 0.0]
        self._build()

    def _build(self) -> None:
        dp = self._dp
        self._inverter = dp.emt.ph3.GFL("GFL", dp.LogLevel.off)
        self._inverter.set_filter_parameters(*FILTER)
        self._inverter.with_control(True)
        self._set_parameters()
        self._parts, self._simulation = self.connect(self._inverter, [], DT / STEPS)
        self._simulation.start()
        self._source = self._parts[-1].attr("V_ref")
        self._nominal = self._source.get()
        self._powers = [self._inverter.attr(name) for name in ("p_inst", "q_inst")]

    def connect(self, inverter: Any, ends: list[Any], step: float) -> tuple[list[Any], Any]:
        """Connect an inverter, after other ends, to line and grid, in steady state.

        Returns all that must live as long as the simulation, and that.
        """
        dp, off = self._dp, self._dp.LogLevel.off
        impedance, terminal = complex(RESISTANCE, OMEGA * INDUCTANCE), complex(VOLTAGE)
        for _ in range(50):  # power flow by fixed-point iteration
            terminal = VOLTAGE + impedance * (self._power / terminal).conjugate()
        voltages = {
            "inverter": terminal,
            "line": terminal - RESISTANCE * (self._power / terminal).conjugate(),
            "grid": complex(VOLTAGE),
        }
        nodes = [dp.emt.SimNode(name, dp.PhaseType.ABC) for name in voltages]
        for node, voltage in zip(nodes, voltages.values(), strict=True):
            node.set_initial_voltage(dp.Math.single_phase_variable_to_three_phase(voltage))
        resistor, inductor = dp.emt.ph3.Resistor("R", off), dp.emt.ph3.Inductor("L", off)
        resistor.set_parameters(dp.Math.single_phase_parameter_to_three_phase(RESISTANCE))
        inductor.set_parameters(dp.Math.single_phase_parameter_to_three_phase(INDUCTANCE))
        source = dp.emt.ph3.NetworkInjection("source", off)
        source.set_parameters(dp.Math.single_phase_variable_to_three_phase(VOLTAGE))
        parts = [inverter, resistor, inductor, source]
        places = ([*ends, nodes[0]], nodes[:2], nodes[1:], nodes[2:])
        for part, place in zip(parts, places, strict=True):
            part.connect(place)
        system = dp.SystemTopology(50, nodes, parts)
        simulation = dp.Simulation("inverter", off)
        simulation.set_system(system)
        simulation.set_time_step(step)
        simulation.set_final_time(1e9)  # never
        simulation.set_domain(dp.Domain.EMT)
        simulation.set_solver(dp.Solver.MNA)
        simulation.do_init_from_nodes_and_terminals(True)
        return [system, nodes, *parts], simulation

    def _set_parameters(self) -> None:
        kp, kp_pll = self._theta
        self._inverter.set_parameters(OMEGA, VOLTAGE, self._power, 0.0)
        self._inverter.set_controller_parameters(kp_pll, KI, kp, KI, *CURRENT, OMEGA)

    def measure(self, t: float, rng: random.Random) -> tuple[list[float], list[float]]:
        """Return active and reactive power as measured [kW], [kvar], and as they are."""
        powers = [power.get() / 1e3 for power in self._powers]
        return [power + rng.gauss(0.0, NOISE) for power in powers], powers

    def advance(self, t: float, *theta: float) -> None:
        """Go on by one sample."""
        if theta != self._theta:
            self._theta = theta
            self._set_parameters()
        for i, (size, memory) in enumerate(GRID):  # Ornstein-Uhlenbeck processes
            kept = math.exp(-DT / memory)
            push = size * math.sqrt(1.0 - kept**2) * self._random.gauss(0.0, 1.0)
            self._grid[i] = kept * self._grid[i] + push
        magnitude, angle = self._grid
        self._source.set((1.0 + magnitude) * cmath.exp(1j * angle) * self._nominal)
        for _ in range(STEPS):
            self._simulation.next()
        if not all(abs(power.get()) < TRIP for power in self._powers):  # nor a number
            print(f"t = {t:g} s, theta = {theta}: tripped, replaced by a new one", flush=True)
            self._build()

    def set(self, name: str, value: float) -> None:
        """Set the reference power, the only thing that has a name."""
        self._power = value
        self._set_parameters()


def register(rigs: Any) -> None:
    """Add it to the command line."""
    text = "a grid-following inverter on a weak line (DPsim), shaken by the grid"
    parse_rig(rigs, "inverter", text, Inverter)
