"""Koopman models of an oscillation, a cost from their modes, and a controller that seeks its least.

The public names of the wheel, for NumPy arrays: identify a model from a recording
(:class:`~koop_esc.estimator.EDMD`, as scikit-learn's estimators are used), turn each measured state
into a cost (:class:`~koop_esc.online.Cost`), and answer each cost with the control input
(:class:`~koop_esc.online.Seeker`). What is behind them are the kernels of the ROS 2 nodes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from koop_bag.bag.columns import read_columns
    from koop_bag.bag.reader import BagReader
    from koop_core.errors import KoopError
    from koop_esc.estimator import EDMD
    from koop_esc.online import Cost, Seeker
    from koop_loop.loop import simulate
    from koopman_lifter.model import KoopmanModel, load
    from relay_esc.config import EscConfig

__all__ = ["EDMD", "BagReader", "Cost", "EscConfig", "KoopError", "KoopmanModel", "Seeker", "load",
           "read_columns", "simulate"]  # fmt: skip
_HOMES = {
    "EDMD": "koop_esc.estimator",
    "BagReader": "koop_bag.bag.reader",
    "Cost": "koop_esc.online",
    "EscConfig": "relay_esc.config",
    "KoopError": "koop_core.errors",
    "KoopmanModel": "koopman_lifter.model",
    "Seeker": "koop_esc.online",
    "load": "koopman_lifter.model",
    "read_columns": "koop_bag.bag.columns",
    "simulate": "koop_loop.loop",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is asked for: numba alone takes half a second."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOMES[name]), name)
