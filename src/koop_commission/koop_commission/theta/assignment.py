"""First line to a commander of theta: the rig, and how it is commanded. Pure: no ROS."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from koop_tune.rig.rig_file import RigFile


@dataclass(frozen=True)
class Assignment:
    """A rig whose theta is commanded, and how.

    Attributes
    ----------
    rig : RigFile
        Command, limits, ``theta_safe``.
    theta : float
        Value that theta has now.
    source, state_type : str
        Topic with fields, and message type, of the states to answer.
    command_type : str
        Message type of the command, ``pkg/msg/Type``.
    recorders : int
        Recorders that must subscribe to theta before it moves.
    note : str
        File for the value at which theta is left; empty: none.
    follows : str
        Topic of a controller whose theta may be followed; empty: none.
    rescue : bool
        Whether another commander has moved theta and was killed.
    """

    rig: RigFile
    theta: float
    source: str
    state_type: str
    command_type: str
    recorders: int = 0
    note: str = ""
    follows: str = ""
    rescue: bool = False

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Assignment:
        """Return it from its JSON terms; the opposite of :meth:`as_json`."""
        return cls(**{**values, "rig": RigFile(**values["rig"])})

    def as_json(self) -> dict[str, Any]:
        """Return it in JSON terms."""
        return asdict(self)
