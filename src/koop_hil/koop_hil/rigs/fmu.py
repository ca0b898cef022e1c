"""Any Functional Mock-up Unit as a rig, by FMPy: model exchange or co-simulation, FMI 1 to 3.

Theta is one of its inputs, or of its tunable parameters, by name; the channels are any of its
numbers. The FMU holds the physics; this module steps it.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from stand import INSTALL, Change, Knob, Schedule, Stand, change

NUMBERS = ("Real", "Float64", "Float32")
FOREVER = 1e9  # [s]
SHOWN = 12  # names in an error


def register(rigs: Any, common: argparse.ArgumentParser) -> None:
    """Add it to the command line."""
    parser = rigs.add_parser(
        "fmu", parents=[common],
        help="any FMU; publishes sensor_msgs/JointState on /fmu, its outputs as positions, and "
        "takes std_msgs/Float64 on /theta",
    )  # fmt: skip
    parser.add_argument("file", metavar="MODEL.fmu")
    parser.add_argument("--input", required=True, metavar="NAME", help="variable that is theta")
    parser.add_argument(
        "--outputs", required=True, metavar="NAME,NAME", help="variables that are measured"
    )
    parser.add_argument("--dt", type=float, required=True, help="time between two samples [s]")
    parser.add_argument("--theta-min", type=float, default=-math.inf, help="stroke of theta")
    parser.add_argument("--theta-max", type=float, default=math.inf)
    parser.add_argument("--noise", type=float, default=0.0, help="of every output")
    parser.add_argument(
        "--model-exchange", action="store_true", help="of an FMU that can be both: with CVODE"
    )
    parser.add_argument(
        "--at", action="append", type=change, default=[], metavar="[T:]NAME=VALUE",
        help="set a variable, at this time [s] or from the start; repeatable",
    )  # fmt: skip
    parser.set_defaults(run=run)


class Model:
    """An FMU that has been read.

    Parameters
    ----------
    file : str
        The FMU.
    knob : str
        Variable that is theta.
    outputs : sequence of str
        Variables that are measured.
    exchange : bool
        Whether model exchange is wanted where there is co-simulation, too.
    changes : sequence of Change
        Variables that are set.

    Raises
    ------
    ValueError
        If FMPy is not installed, there is no such file or variable, or it cannot be moved.
    """

    def __init__(
        self, file: str, knob: str, outputs: Sequence[str], exchange: bool = False,
        changes: Sequence[Change] = (),
    ) -> None:  # fmt: skip
        try:
            import fmpy
        except ImportError as error:
            raise ValueError(f"{error}: {INSTALL}") from None
        if not Path(file).is_file():
            raise ValueError(f"{file}: there is no such FMU")
        try:
            self.description = fmpy.read_model_description(file)
        except Exception as error:  # of zipfile, lxml or its own
            raise ValueError(f"{file} is not an FMU: {_line(error)}") from None
        own = self.description
        kinds = [("ModelExchange", own.modelExchange), ("CoSimulation", own.coSimulation)]
        offered = [name for name, there in kinds if there is not None]
        wanted = "ModelExchange" if exchange else "CoSimulation"
        if exchange and wanted not in offered:
            raise ValueError(f"{file} is for co-simulation only: leave --model-exchange out")
        if not offered:
            raise ValueError(f"{file} offers neither co-simulation nor model exchange")
        self.kind = wanted if wanted in offered else offered[0]
        self.file, self._known = file, {v.name: v for v in own.modelVariables}
        self.knob = self._settable(knob, "--input")
        self.outputs = [self._number(name, "--outputs") for name in outputs]
        self.changes = [(c, self._settable(c.name, "--at")) for c in changes]

    def _number(self, name: str, option: str) -> Any:
        """Return a variable that is a number."""
        found = self._known.get(name)
        if found is None:
            numbers = [v.name for v in self._known.values() if v.type in NUMBERS]
            raise ValueError(f"{option}: {self.file} has no variable {name!r}; {_some(numbers)}")
        if found.type not in NUMBERS or found.dimensions:
            raise ValueError(f"{option}: {name!r} is not one real number, but {found.type}")
        return found

    def _settable(self, name: str, option: str) -> Any:
        """Return a variable that may be set while it runs."""
        found = self._number(name, option)
        if not self._movable(found):
            free = [v.name for v in self._known.values() if v.type in NUMBERS and self._movable(v)]
            raise ValueError(f"{option}: {name!r} cannot be set while it runs; {_some(free)}")
        return found

    def _movable(self, variable: Any) -> bool:
        """Return whether a variable may be set; a parameter only between two steps."""
        tunable = variable.variability == "tunable" and self.kind == "CoSimulation"
        return variable.causality == "input" or tunable

    def run(
        self, dt: float, theta: float, exchange: Callable[[float, list[float]], float | None]
    ) -> None:
        """Simulate; after every step a function is given time and outputs and returns theta.

        Parameters
        ----------
        dt : float
            Time between two samples [s].
        theta : float
            At the start.
        exchange : callable
            Returns None to end it.

        Raises
        ------
        ValueError
            If the FMU fails.
        """
        import fmpy

        schedule = Schedule([c for c, _ in self.changes])
        variables = {c.name: v for c, v in self.changes}
        steps = 0

        def after_step(time: float, recorder: Any) -> bool:
            nonlocal steps
            recorder.rows.clear()  # it would keep all
            if time < (steps + 1) * dt * (1.0 - 1e-9):
                return True  # an event between two samples
            steps += 1
            unit = recorder.fmu
            wanted = exchange(time, [_get(unit, v) for v in self.outputs])
            if wanted is None:
                return False
            _set(unit, self.knob, wanted)
            for item in schedule.due(time):
                _set(unit, variables[item.name], item.value)
            return True

        first = {c.name: c.value for c in schedule.due(0.0)}
        try:
            fmpy.simulate_fmu(
                self.file, start_time=0.0, stop_time=FOREVER, output_interval=dt,
                step_size=dt, fmi_type=self.kind, record_events=False, set_stop_time=False,
                start_values={**first, self.knob.name: theta}, step_finished=after_step,
                model_description=self.description, output=[self.outputs[0].name],
            )  # fmt: skip
        except Exception as error:  # the FMU's own, or of its library
            raise ValueError(f"{self.file}: {_line(error)}") from None


def run(args: argparse.Namespace, begin: Callable[[Stand], Stand]) -> None:
    """Run one."""
    model = Model(
        args.file, args.input, args.outputs.split(","), args.model_exchange, args.at
    )  # before DDS: a wrong argument is reported at once
    from wire import JointState, Wire, joint_state

    names = [v.name for v in model.outputs]
    start = args.theta_initial
    if start is None:
        start = float(model.knob.start or 0.0)
    said = joint_state(names)
    wire = Wire(args.state or "fmu", args.theta or "theta", JointState, said, False, args.truth)
    knob = Knob(start, args.theta_min, args.theta_max)
    stand = begin(Stand(args, wire, args.dt, knob))

    def exchange(time: float, x: list[float]) -> float | None:
        if not all(map(math.isfinite, x)):
            raise ValueError(f"an output is not a number at t = {time:g} s")
        return stand.exchange([v + stand.rng.gauss(0.0, args.noise) for v in x], x)

    model.run(args.dt, start, exchange)


def _get(unit: Any, variable: Any) -> float:
    return float(getattr(unit, "get" + variable.type)([variable.valueReference])[0])


def _set(unit: Any, variable: Any, value: float) -> None:
    getattr(unit, "set" + variable.type)([variable.valueReference], [value])


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]


def _some(names: Sequence[str]) -> str:
    more = ", ..." if len(names) > SHOWN else ""
    return f"there is {', '.join(names[:SHOWN])}{more}" if names else "there is none"
