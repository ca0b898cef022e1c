#!/usr/bin/env python3
"""Builds the FMU of this folder: a mass with a tuned absorber."""

import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from zipfile import ZipFile

HERE = Path(__file__).parent


def build(path):
    """Compile and zip it."""
    with TemporaryDirectory() as folder:
        library = Path(folder) / "absorber.so"
        compiler = os.environ.get("CC", "cc")
        subprocess.run([compiler, "-O2", "-fPIC", "-shared", "-fvisibility=hidden", "-o", library,
                        HERE / "absorber.c", "-lm"], check=True)  # fmt: skip
        with ZipFile(path, "w") as fmu:
            fmu.write(HERE / "modelDescription.xml", "modelDescription.xml")
            fmu.write(library, "binaries/linux64/absorber.so")


if __name__ == "__main__":
    build(sys.argv[1])
