"""Hardware in the loop: scenarios and faults at random on the real nodes, and verdicts."""

from importlib.resources import files
from pathlib import Path


def installed(folder: str) -> Path:
    """Return a folder of the package's data: ``scenarios``, ``models`` or ``rigs``."""
    return Path(str(files("koop_hil") / folder))
