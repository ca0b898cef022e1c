"""The wheel of what needs no ROS imports and runs where none is installed."""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from sklearn.preprocessing import PolynomialFeatures
from sklearn.utils.estimator_checks import (
    check_dataframe_column_names_consistency,
    check_transformer_get_feature_names_out_pandas,
)

from koop_loop.loop import simulate
from koopman_lifter.config import LifterConfig
from relay_esc.config import EscConfig
from vdp_plant.config import PlantConfig

ROOT = Path(__file__).parents[2]
WHEEL = ROOT / "python"
BAG = ROOT / "recordings" / "golden" / "run" / "bag"
LIBRARIES = ("numpy", "numpy.libs", "scipy", "scipy.libs", "numba", "llvmlite", "llvmlite.libs",
             "yaml", "_yaml", "mcap", "mcap_ros2", "zstandard", "lz4", "tqdm",
             "sklearn", "scikit_learn", "scikit_learn.libs", "joblib", "threadpoolctl.py",
             "cloudpickle")  # fmt: skip
IMPORT_ALL = """
import importlib, pkgutil, sys
import {packages}
for package in ({packages},):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        importlib.import_module(module.name)
assert not any(name in sys.modules for name in ("rclpy", "koop_node", "koop_msgs"))
"""
SAVE = """
from pathlib import Path
import numpy as np
from koop_bag.bag.columns import read_columns
from koop_bag.bag.reader import BagReader
with BagReader(Path({bag!r})) as bag:
    np.save("states.npy", read_columns(bag, "/state", ["x"])["x"])
"""
FACADE = """
import sys
import koop_esc
assert not {"numba", "sklearn"} & set(sys.modules)  # half a second each
assert all(getattr(koop_esc, name) is not None for name in koop_esc.__all__)
import doctest
from sklearn.utils.estimator_checks import check_estimator
import koop_esc.estimator, koop_esc.online
for module in (koop_esc.estimator, koop_esc.online):
    results = doctest.testmod(module)
    assert results.attempted and not results.failed
check_estimator(koop_esc.EDMD(degree=1))
"""
MISTAKES = """
import numpy as np
from koop_esc import EDMD, Cost, Seeker
x = np.random.default_rng(0).standard_normal((90, 2))
edmd = EDMD(degree=1, modes=2, dt=0.01).fit(x)
of_numpy = EDMD(degree=np.int64(1), modes=np.int64(2), dt=np.float64(0.01)).fit(x)
assert of_numpy.model_.model_id == edmd.model_.model_id  # no JSON of its integers, before
for call, words in (
    (lambda: EDMD(dt=0.01).fit(np.zeros((2, 9000))), "2 samples (rows) of 9000 channels (columns)"),
    (lambda: EDMD(dt=0.0).fit(np.zeros((90, 2))), "dt = 0: must be above 0 and below"),
    (lambda: EDMD(dt=np.inf).fit(np.zeros((90, 2))), "dt = inf: must be above 0 and below"),
    (lambda: Cost(EDMD()), "not fitted yet"),
    (lambda: Cost(edmd).step(1.0), "the state has 1 values, the model needs 2"),  # as 1.0, 1.0
    (lambda: Seeker(0.0), "dt = 0: must be a number of at least 1e-06 s"),
    (lambda: Seeker(1e-300), "dt = 1e-300: must be a number"),
    (lambda: Seeker(0.01, margin_slope=-0.5), "keeps no such bound"),
):
    try:
        call()
    except ValueError as error:
        assert words in str(error), error
    else:
        raise AssertionError(words)
both = Cost(edmd), Cost(edmd.model_)
assert all(np.equal(*(cost.step(row) for cost in both)) for row in x)
"""
GOLDEN = """
from pathlib import Path
import numpy as np
from koop_esc import BagReader, Cost, Seeker, load, read_columns
with BagReader(Path({run!r}) / "bag") as bag:
    x, theta = (read_columns(bag, topic, [field])[field]
                for topic, field in (("/state", "x"), ("/theta", "theta")))
model = load(Path({run!r}) / "model" / "vdp.npz")
cost, seeker = Cost(model), Seeker(model.dt, dwell=1.0, tau_f=1.0, step_size=0.01, theta_max=3.0)
assert np.array_equal([seeker.step(cost.step(row)) for row in x], theta[:, 0])
"""
NOTEBOOK = """
import json, sys
sys.path.append({wheel!r})
names = {{}}
for cell in json.loads(open({path!r}).read())["cells"]:
    if cell["cell_type"] == "code":
        exec("".join(cell["source"]), names)
"""


@pytest.fixture(scope="module")
def python(tmp_path_factory):
    """Run Python code with the wheel and the libraries of its packages, and nothing else."""
    folder = tmp_path_factory.mktemp("without_ros")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder]
    subprocess.run(build, cwd=WHEEL, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(folder)
    for copy in folder.rglob("*.py"):  # it takes the kernels that its source's have compiled
        source = WHEEL / copy.relative_to(folder)
        shutil.copystat(source, copy)
        kept = source.parent / "__pycache__"
        kept.mkdir(exist_ok=True)
        if not (link := copy.parent / "__pycache__").exists():
            link.symlink_to(kept)
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
    packages = [folder.parent.name for folder in WHEEL.glob("*/__init__.py")]
    done = python(IMPORT_ALL.format(packages=", ".join(packages)))
    assert done.returncode == 0, done.stderr


def test_the_example_of_its_readme_runs(python):
    (example,) = re.findall("```python\n(.*?)```", (WHEEL / "README.md").read_text(), re.DOTALL)
    done = python(SAVE.format(bag=str(BAG)) + example)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("[")


def test_its_public_names_are_found_and_its_estimator_is_one_of_scikit_learn(python):
    done = python(FACADE)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_mistake_with_arrays_is_named_and_a_fitted_estimator_is_a_model(python):
    done = python(MISTAKES)
    assert done.returncode == 0, done.stderr


def test_the_columns_of_a_data_frame_name_the_states_as_in_scikit_learn():
    pandas = pytest.importorskip("pandas", reason="it comes with the plants")
    sys.path.append(str(WHEEL))
    from koop_esc import EDMD

    check_transformer_get_feature_names_out_pandas("EDMD", EDMD(degree=1))
    check_dataframe_column_names_consistency("EDMD", EDMD(degree=1))
    x = np.random.default_rng(0).standard_normal((90, 2))
    edmd = EDMD(degree=2, modes=2).fit(pandas.DataFrame(x, columns=["roll", "pitch"]))
    expected = PolynomialFeatures(2).fit(pandas.DataFrame(x, columns=["roll", "pitch"]))
    names = [name.replace(" ", "*") for name in expected.get_feature_names_out()]
    assert list(edmd.get_feature_names_out()) == names
    assert edmd.model_.state_names == ("roll", "pitch")
    assert edmd.fit(x).model_.state_names == ("x0", "x1")


def test_it_answers_a_recording_as_the_nodes_did_over_dds(python):
    done = python(GOLDEN.format(run=str(BAG.parent)))
    assert done.returncode == 0, done.stderr


def test_it_seeks_several_inputs_as_the_loop_does():
    sys.path.append(str(WHEEL))
    from koop_esc import Seeker

    two = {"theta_initial": (2.0, 1.0), "theta_min": (-5.0, -4.0)}
    plant, lifter = (
        PlantConfig(theta_star=(-3.0, 1.0), theta_initial=(2.0, 1.0)),
        LifterConfig(cost="raw"),
    )
    loop = simulate(plant, lifter, EscConfig(**two), None, 2000)
    seeker = Seeker(plant.dt, **two)
    assert np.array_equal([seeker.step(r) for r in loop.r], loop.theta)


@pytest.mark.parametrize("path", sorted(WHEEL.glob("notebooks/*.ipynb")), ids=lambda p: p.stem)
def test_a_notebook_runs(path, tmp_path):
    code = NOTEBOOK.format(wheel=str(WHEEL), path=str(path))
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path,
        env={**os.environ, "MPLBACKEND": "Agg"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
