"""Units of work: what one process computes at a stretch, and their results on disk.

A result's file is named by a hash of the work, its arguments and the code that does it. A study
that was stopped goes on where it was; one whose numerical code changed starts anew.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import koop_loop
import koop_study
import koopman_lifter
import relay_esc
import vdp_plant

NUMERICAL = {  # package: files whose code decides results
    vdp_plant: ("config.py", "dynamics.py"),
    relay_esc: ("config.py", "relay.py"),
    koopman_lifter: (
        "config.py", "contrast.py", "cost.py", "edmd.py", "model.py", "modes.py", "observables.py",
    ),
    koop_loop: ("loop.py", "metrics.py", "training.py"),
    koop_study: (
        "case.py", "controllers/adaptive.py", "controllers/perturbation.py", "kernel.py",
        "learning.py", "maps.py", "run.py", "scenario.py", "variants.py", "workers/work.py",
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Unit:
    """A function of :mod:`koop_study.workers.work` by name, with its arguments in JSON terms."""

    work: str
    arguments: dict[str, Any]

    @property
    def key(self) -> str:
        """Name of the result: the same work with the same code has the same key."""
        text = json.dumps([self.work, self.arguments, fingerprint()], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:24]


@lru_cache(maxsize=1)
def fingerprint() -> str:
    """Return a hash of the numerical code."""
    digest = hashlib.sha256()
    for package, names in NUMERICAL.items():
        folder = Path(str(package.__file__)).parent
        for name in names:
            digest.update((folder / name).read_bytes())
    return digest.hexdigest()


class Store:
    """Results of units, one JSON file each.

    Parameters
    ----------
    folder : Path
        Made if it does not exist.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def has(self, unit: Unit) -> bool:
        """Return True if the unit's result is there."""
        return self._path(unit).exists()

    def load(self, unit: Unit) -> Any:
        """Return a unit's result."""
        return json.loads(self._path(unit).read_text())

    def save(self, unit: Unit, result: Any) -> None:
        """Write a unit's result; a file is whole or absent, whenever the program is stopped."""
        write_atomically(self._path(unit), json.dumps(result))

    def _path(self, unit: Unit) -> Path:
        return self.folder / f"{unit.key}.json"


def write_atomically(path: Path, text: str) -> None:
    """Write a text file so that a reader sees the old content or the new, never a part."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=".part")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        os.chmod(name, 0o644)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
