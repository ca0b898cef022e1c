"""The wheel of what needs no ROS imports and runs where none is installed."""

import importlib.util
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from koop_bag.bag.reader import BagReader
from koop_loop.loop import simulate
from koopman_lifter.config import LifterConfig
from relay_esc.config import EscConfig
from vdp_plant.config import PlantConfig

ROOT = Path(__file__).parents[2]
WHEEL = ROOT / "python"
BAG = ROOT / "recordings" / "golden" / "run" / "bag"
LIBRARIES = ("numpy", "numpy.libs", "scipy", "scipy.libs", "numba", "llvmlite", "llvmlite.libs",
             "yaml", "_yaml", "mcap", "mcap_ros2", "zstandard", "lz4", "tqdm")  # fmt: skip
IMPORT_ALL = """
import importlib, pkgutil, sys
import {packages}
for package in ({packages},):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        importlib.import_module(module.name)
assert not any(name in sys.modules for name in ("rclpy", "koop_node", "koop_msgs"))
"""
RUN = """
from pathlib import Path
from koop_bag.bag.columns import read_columns
from koop_bag.bag.reader import BagReader
from koop_loop.loop import simulate
from koopman_lifter.config import LifterConfig
from relay_esc.config import EscConfig
from vdp_plant.config import PlantConfig
loop = simulate(PlantConfig(), LifterConfig(cost="raw"), EscConfig(), None, 2000)
with BagReader(Path({bag!r})) as bag:
    print(loop.theta[-1].hex(), read_columns(bag, "/theta", ["theta"])["theta"].size)
"""
SAVE = """
from pathlib import Path
import numpy as np
from koop_bag.bag.columns import read_columns
from koop_bag.bag.reader import BagReader
with BagReader(Path({bag!r})) as bag:
    np.save("states.npy", read_columns(bag, "/state", ["x"])["x"].T)
"""


@pytest.fixture(scope="module")
def python(tmp_path_factory):
    """Run Python code with the wheel and the libraries of its packages, and nothing else."""
    folder = tmp_path_factory.mktemp("without_ros")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder]
    subprocess.run(build, cwd=WHEEL, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(folder)
    site = Path(importlib.util.find_spec("numpy").origin).parents[1]
    for name in LIBRARIES:
        if (site / name).exists():
            (folder / name).symlink_to(site / name)
    for path in site.glob("*.dist-info"):
        if path.name.split("-")[0].lower() in {name.lower() for name in LIBRARIES}:
            (folder / path.name).symlink_to(path)

    first = f"import sys; sys.path.append({str(folder)!r})"

    def run(code):
        return subprocess.run(
            [sys.executable, "-I", "-S", "-c", f"{first}\n{code}"],
            capture_output=True,
            text=True,
            cwd=folder,
            env={"PATH": "/usr/bin:/bin", "HOME": str(folder)},
        )

    return run


def test_there_is_no_ros(python):
    assert "No module named 'rclpy'" in python("import rclpy").stderr


def test_every_module_imports(python):
    packages = [link.name for link in WHEEL.iterdir() if link.is_symlink()]
    done = python(IMPORT_ALL.format(packages=", ".join(packages)))
    assert done.returncode == 0, done.stderr


def test_a_loop_runs_and_a_bag_is_read_as_with_ros(python):
    done = python(RUN.format(bag=str(BAG)))
    assert done.returncode == 0, done.stderr
    theta, count = done.stdout.split()
    plant, lifter, esc = PlantConfig(), LifterConfig(cost="raw"), EscConfig()
    assert theta == simulate(plant, lifter, esc, None, 2000).theta[-1].hex()
    with BagReader(BAG) as bag:
        assert int(count) == bag.topic("/theta").count > 0


def test_the_example_of_its_readme_runs(python):
    (example,) = re.findall("```python\n(.*?)```", (WHEEL / "README.md").read_text(), re.DOTALL)
    done = python(SAVE.format(bag=str(BAG)) + example)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("[")
