"""Colcon, which starts one interpreter for each Python package in place of four.

For every package it asks an interpreter for the arguments of setup.py, another for the commands of
setuptools, a third for the options of one, and only then builds in a fourth. The first answer is
had here, the others are the same for each package: those of the setuptools that is pinned.

The executables that setuptools writes look up in the metadata of their package what they start,
which takes 40 ms of every start: they are written anew.
"""

import os
import sys
from distutils.core import run_setup
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

from colcon_core.command import main
from colcon_core.task.python.build import PythonBuildTask
from colcon_ros.package_augmentation import ros_ament_python


def read_setup(setup_py: Path, **_: Any) -> dict[str, Any]:
    """Return the arguments of a setup.py."""
    folder = os.getcwd()
    os.chdir(setup_py.parent)
    try:
        return vars(run_setup(setup_py.name, stop_after="config"))
    finally:
        os.chdir(folder)


async def find_commands(*_: Any) -> set[str]:
    """Return the command of setuptools that colcon looks for, to link the sources."""
    return {"develop"}


async def find_options(*_: Any) -> set[str]:
    """Return the option of it that colcon looks for."""
    return {"--editable"}


def write_executables() -> None:
    """Let every executable import what it starts."""
    for folder in Path("build").iterdir():
        for distribution in distributions(path=[str(folder)]):
            for entry in distribution.entry_points.select(group="console_scripts"):
                file = Path("install", folder.name, "lib", folder.name, entry.name)
                if file.exists():
                    file.write_text(
                        f"#!{sys.executable}\n"
                        "import sys\n\n"
                        f"from {entry.module} import {entry.attr}\n\n"
                        f"sys.exit({entry.attr}())\n"
                    )


ros_ament_python.get_setup_information = read_setup
PythonBuildTask._get_available_commands = find_commands
PythonBuildTask._get_available_options = find_options
code = main()
if not code:
    write_executables()
sys.exit(code)
