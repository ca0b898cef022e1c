"""Units of work: what one process computes at a time, and their results on disk.

A result's file is named by a hash of the work, its arguments and the code that does it. A study
that was stopped goes on where it was; after a change of the numerical code everything is computed
again, after one of a module that only one law calls what that law did.
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
import tempfile
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import koop_lab
import koop_loop
import koop_node
import koopman_lifter
import relay_esc
import vdp_plant
from koop_study import commissioning, controllers, family, laws, simulation

# All code of these decides results, but for the modules that know ROS.
PACKAGES = (vdp_plant, relay_esc, koopman_lifter, koop_loop, simulation, controllers, family, laws)
ROS = {"node.py", "executable.py"}
LAB = Path(str(koop_lab.__file__)).parent
COMMISSION = "commission_plant"  # the one work that these decide, too
SURVEYED = ("channels", "features", "progress", "rig_file", "staircase", "survey", "valley")
COMMISSIONING = (
    Path(str(commissioning.__file__)).parent,
    LAB / "tune",
    LAB / "identify",
    *(LAB / "commission" / f"{name}.py" for name in SURVEYED),
)
OF_ONE_LAW = {  # modules that no other law's numbers depend on
    "relay_esc/swing.py": "adaptive",
    **{
        f"laws/{name}.py": name
        for name in ("bounded", "golden", "least_squares", "newton", "sliding", "stochastic")
    },
}
LIBRARIES = ("numpy", "scipy", "numba")  # another version may round in another way


@dataclass(frozen=True)
class Unit:
    """A function of :mod:`koop_study.workers.registry`, with its arguments in JSON terms."""

    work: str
    arguments: dict[str, Any]

    @property
    def key(self) -> str:
        """Name of the result: the same work with the same code has the same key."""
        further = self.work == COMMISSION
        code = fingerprint("" if further else self.arguments.get("law", ""), further)
        text = json.dumps([self.work, self.arguments, code], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:24]


@lru_cache(maxsize=32)
def fingerprint(law: str = "", commissioning: bool = False) -> str:
    """Return a hash of all that decides results: our code, and the libraries' versions.

    Of a law's results, other laws' own modules decide nothing. With ``commissioning``, of what
    decides :data:`COMMISSION`.
    """
    digest = hashlib.sha256()
    for name in LIBRARIES:
        digest.update(f"{name} {version(name)}\n".encode())
    for path in deciding(COMMISSIONING if commissioning else ()):
        name = f"{path.parent.name}/{path.name}"
        if not law or OF_ONE_LAW.get(name, law) == law:
            digest.update(f"{name} {meaning(path.read_text())}\n".encode())
    return digest.hexdigest()


def deciding(further: tuple[Path, ...] = ()) -> list[Path]:
    """Return the numerical packages' modules and those of koop_node that they import.

    Modules, and those of folders, may be added.
    """
    found: list[Path] = []
    for place in (*(Path(str(package.__file__)).parent for package in PACKAGES), *further):
        modules = sorted(place.rglob("*.py")) if place.is_dir() else [place]
        found += [path for path in modules if path.name not in ROS]
    shared = Path(str(koop_node.__file__)).parent
    for path in found:  # what is appended is looked at too
        for name in sorted(shared_modules(path)):
            if shared / name not in found:
                found.append(shared / name)
    return found


def shared_modules(path: Path) -> set[str]:
    """Return the files of koop_node that a module imports from."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module == "koop_node":
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and str(node.module).startswith("koop_node."):
            names.add(str(node.module).split(".")[1])
    return {f"{name}.py" for name in names}


def meaning(source: str) -> str:
    """Return a hash of what a module does: comments, docstrings and line breaks do not count."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
            and node.body
            and isinstance(node.body[0], ast.Expr)
            and isinstance(node.body[0].value, ast.Constant)
        ):
            node.body[0].value.value = ""
    return hashlib.sha256(ast.dump(tree).encode()).hexdigest()


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
