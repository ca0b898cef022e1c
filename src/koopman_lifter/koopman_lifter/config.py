"""Configuration of the lifter: which cost, from which model, seen through which detector."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from koop_core.config.constraint import Constraint, parse_constraint
from koop_core.config.fields import Source, parse_source
from koop_core.config.parameter import Settings, parameter
from koop_core.stream.arrival import LONGEST_DT, SHORTEST_DT
from koopman_lifter.cost import LIFTED, RAW, DetectorParams, detector_params

SOURCES = {"raw": RAW, "lifted": LIFTED}


@dataclass(frozen=True)
class LifterConfig(Settings):
    """Cost and amplitude detector (paper section 3.4).

    The paper gives no value of the detector's corner frequencies; these are the defaults of this
    project (docs/explanation/theory.md says how they were found).
    """

    cost: str = parameter(
        "lifted",
        "which energy the cost is made of (the block diagram's switch)",
        choices=tuple(SOURCES),
    )
    omega_h: float = parameter(
        20.0,
        "corner frequency of the detector's high-pass filter",
        unit="rad/s",
        low=1e-8,
        high=1e6,
    )
    omega_l: float = parameter(
        0.3, "corner frequency of the detector's low-pass filter", unit="rad/s", low=1e-8, high=1e6
    )
    y_out_max: float = parameter(
        0.0,
        "largest y_out that is believed: a state beyond it, such as a sensor's spike, is unusable "
        "(r = NaN, theta is held); some 10 times the largest y_out of a good recording; 0: any",
        low=0.0,
    )
    dt: float = parameter(
        0.005, "sampling time of the state", unit="s", low=SHORTEST_DT, high=LONGEST_DT,
        read_only=True,
    )  # fmt: skip

    measured: str = parameter(
        "",
        "for a rig that speaks another message: topic:field,field, for example "
        "/joint_states:position[0],velocity[0]; the node then publishes 'state' itself; empty: "
        "the rig publishes 'state'",
        read_only=True,
    )

    constraint: str = parameter(
        "",
        "bound on a second signal, rms(/topic:field, 10 s) < 1.5 or peak(...); cost then says what "
        "margin is left; empty: none",
        read_only=True,
    )

    begin: float = parameter(
        0.0,
        "frequency at which the watch begins: within a fifth of it is the oscillation that theta "
        "changes; the lifter sets it where the rig changes; 0: what varies most", unit="Hz",
        low=0.0,
    )  # fmt: skip

    adapt: str = parameter(
        "propose",
        "a better model after a change is proposed to the operator, used at once (always; given "
        "back if the oscillation grows) or not looked for (never)",
        choices=("never", "propose", "always"),  # on and off are booleans in YAML
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.measured:
            parse_source(self.measured)
        parse_constraint(self.constraint)

    @property
    def rig_source(self) -> Source | None:
        """Where the state comes from if not from the topic 'state'."""
        return parse_source(self.measured) if self.measured else None

    @property
    def bounded(self) -> Constraint | None:
        """The constraint; None without one."""
        return parse_constraint(self.constraint)

    @property
    def source(self) -> int:
        """RAW or LIFTED, as in koop_msgs/Cost."""
        return SOURCES[self.cost]

    def detector_params(self) -> DetectorParams:
        """Return the values that ``koopman_lifter.cost.detect`` takes."""
        y_max = self.y_out_max or sys.float_info.max
        return detector_params(self.omega_h, self.omega_l, self.dt, y_max)


@dataclass(frozen=True)
class ModelConfig(Settings):
    """Which model file the node uses."""

    model: str = parameter("", "path of the model file; empty: the one shipped for the plant")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.model:  # a client that asks for the parameter learns which file is in use
            object.__setattr__(self, "model", str(shipped_model()))

    @property
    def path(self) -> Path:
        """The model file."""
        return Path(self.model).expanduser()


def shipped_model() -> Path:
    """Return the model that comes with the package: the paper's plant, degree 3, N = 8, seed 0."""
    return Path(str(files("koopman_lifter") / "models" / "vdp.npz"))
