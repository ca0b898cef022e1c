"""Constants of detector and controller in units of the plant that they are used on.

Times are in units of the plant's own: its slowest amplitude time plus two periods, in which a step
of theta shows. So one set of constants means the same on every rig.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from koop_core.config.parameter import ConfigError
from koop_study.family.loop import RigController
from koop_study.family.rig import Rig
from koopman_lifter.config import LifterConfig
from koopman_lifter.model import KoopmanModel
from relay_esc.config import EscConfig

LAWS = ("relay", "adaptive")


@dataclass(frozen=True)
class ScaledConstants:
    """Constants that the time and the frequency of a plant turn into the nodes' configurations.

    Attributes
    ----------
    omega_h : float
        Corner of the detector's high-pass filter over the oscillation's frequency.
    omega_l : float
        Corner of its low-pass filter times the plant's time.
    speed : float
        Change of theta in the plant's time, in ranges of theta.
    dwell, tau_f : float
        Dwell time and filter of the controller over the plant's time.
    law, step_ratio, lost
        As the controller has them.
    """

    omega_h: float
    omega_l: float
    speed: float
    dwell: float
    tau_f: float
    law: str = "relay"
    step_ratio: float = EscConfig.step_ratio
    lost: float = EscConfig.lost

    def __post_init__(self) -> None:
        if self.law not in LAWS:
            raise ConfigError(f"law = {self.law!r}: must be one of {', '.join(LAWS)}")

    def lifter(self, omega: float, time: float) -> dict[str, Any]:
        """Return the detector's corners [rad/s] for a frequency [rad/s] and a time [s]."""
        return {"omega_h": self.omega_h * omega, "omega_l": self.omega_l / time}

    def esc(self, time: float, span: float, dt: float) -> dict[str, Any]:
        """Return the controller's settings for a time [s], a range of theta and a step [s]."""
        return {
            "law": self.law,
            "step_size": self.speed * span * dt / time,
            "dwell": self.dwell * time,
            "tau_f": self.tau_f * time,
            "step_ratio": self.step_ratio,
            "lost": self.lost,
        }


# the paper's plant has a time of 15 s and oscillates at 1 rad/s
PAPER_TIME, PAPER_OMEGA = 15.0, 1.0


def scaled_to(rig: Rig, constants: ScaledConstants, model: KoopmanModel | None) -> RigController:
    """Return the controller of a rig.

    Parameters
    ----------
    rig : Rig
        Whose limits, time and frequency count.
    constants : ScaledConstants
        In units of the rig.
    model : KoopmanModel or None
        Model of the lifted cost; None for the raw one.
    """
    p, omega = rig.params, 2.0 * math.pi * rig.frequency
    span = math.log(p.theta_max / p.theta_min) if p.log_scale else p.theta_max - p.theta_min
    esc = replace(
        unscaled(rig),
        theta_scale="log" if p.log_scale else "linear",
        **constants.esc(rig.time, span, p.dt),
    )
    return RigController(LifterConfig(dt=p.dt, **constants.lifter(omega, rig.time)), esc, model)


def unscaled(rig: Rig, rate_limit: float = 0.0) -> EscConfig:
    """Return the node's defaults with a rig's limits, objective and dt."""
    p = rig.params
    return EscConfig(
        theta_min=p.theta_min, theta_max=p.theta_max, theta_initial=rig.theta_initial,
        rate_limit=rate_limit, dt=p.dt, objective=rig.objective,
    )  # fmt: skip
