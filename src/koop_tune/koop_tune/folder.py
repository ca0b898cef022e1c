"""Files of a tuned controller, and of the folder that holds it."""

from __future__ import annotations

from pathlib import Path

from koop_core.config.parameter import ConfigError

TUNED = "tuned"  # subfolder of an excitation's folder
CONTROLLER, MODEL, FIGURES = "controller.yaml", "model.npz", "tune.json"
RIG = "rig.yaml"  # copy of the rig file, beside ``TUNED``


def find_controller(path: Path) -> tuple[Path, str]:
    """Return the parameter file meant by a file or its folder, and a label for its runs.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If the folder holds none.
    """
    if not path.is_dir():
        return path, path.stem
    for file in (path / CONTROLLER, path / TUNED / CONTROLLER):
        if file.is_file():
            return file, path.resolve().name
    remedy = "run 'koop tune' first"
    if (path / TUNED / FIGURES).is_file():
        remedy = f"koop tune made none, and says why in {TUNED}/{FIGURES}"
    raise ConfigError(f"{path}: has no {CONTROLLER} and no {TUNED}/{CONTROLLER}: {remedy}")
