"""Hardware in the loop: scenarios with faults on the real nodes, and their verdicts."""

from importlib.resources import files
from pathlib import Path


def installed(folder: str) -> Path:
    """Return a folder of the package's data: ``scenarios``, ``models`` or ``rigs``."""
    return Path(str(files("koop_hil") / folder))
