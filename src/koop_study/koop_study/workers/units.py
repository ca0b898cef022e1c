"""Units of work, which a process computes one at a time, and their results on disk.

A result's file is named by a hash of the work, its arguments and the code that does it. A study
that was stopped resumes; after a change of the numerical code everything is computed
again.
"""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from koop_core.whole_file import write_text

# packages all code of which decides results, but for the modules that know ROS
PACKAGES = (
    "koop_core", "vdp_plant", "koopman_lifter", "relay_esc", "koop_loop", "koop_identify",
    "koop_guard", "koop_tune", "koop_study.simulation", "koop_study.family",
    "koop_study.commissioning",
)  # fmt: skip
ROS = ("node.py", "executable.py")
LIBRARIES = ("numpy", "scipy", "numba")  # another version may round in another way


@lru_cache(maxsize=1)
def fingerprint() -> str:
    """Return a hash of everything that decides results: our code, and the libraries' versions."""
    return digest_of({name: meaning(source) for name, source in sources(PACKAGES).items()})


def digest_of(meanings: Mapping[str, str]) -> str:
    """Return one hash of modules, given the meaning of each, and of the libraries' versions."""
    every = [*((name, version(name)) for name in LIBRARIES), *meanings.items()]
    return hashlib.sha256(json.dumps(every).encode()).hexdigest()


@dataclass(frozen=True)
class Unit:
    """A function of ``koop_study.workers.task.WORK``."""

    work: str
    """Name of the function."""
    arguments: dict[str, Any]
    """Its arguments, in JSON terms."""
    code: str = field(default_factory=fingerprint)
    """Fingerprint of the code that decides the result."""

    @property
    def key(self) -> str:
        """Name of the result: the same work with the same code has the same key."""
        text = json.dumps([self.work, self.arguments, self.code], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:24]


def sources(packages: Sequence[str]) -> dict[str, str]:
    """Return the modules of packages by package and path, but for those that know ROS."""
    texts = {}
    for package in packages:
        spec = find_spec(package)
        assert spec is not None
        for folder in map(Path, spec.submodule_search_locations or ()):
            for path in sorted(folder.rglob("*.py")):
                if path.name not in ROS:
                    texts[f"{package}/{path.relative_to(folder)}"] = path.read_text()
    return texts


class _WithoutTexts(ast.NodeTransformer):
    """Removes docstrings, those of fields and constants included."""

    def visit_Expr(self, node: ast.Expr) -> ast.Expr | None:
        return None if isinstance(node.value, ast.Constant) else node


def meaning(source: str) -> str:
    """Return a hash of a module's code without comments, docstrings and line breaks."""
    tree = _WithoutTexts().visit(ast.parse(source))
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
        write_text(self._path(unit), json.dumps(result))

    def _path(self, unit: Unit) -> Path:
        return self.folder / f"{unit.key}.json"
