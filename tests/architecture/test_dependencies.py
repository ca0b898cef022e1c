"""package.xml names what a package imports: all of it, and nothing else; setup.py the extras."""

import ast
import importlib.util
import re
import runpy
import sys
import xml.etree.ElementTree as ElementTree
from itertools import pairwise
from pathlib import Path

import pytest

SRC = Path(__file__).parents[2] / "src"
PACKAGES = {path.parent.name for path in SRC.glob("*/package.xml")}
OURS = sorted(name for name in PACKAGES if (SRC / name / "setup.py").is_file())

# A module that is not of ROS: its key in package.xml, which rosdep resolves, and its name on PyPI.
# rosdistro has no keys for mcap, zstandard and lz4; pip installs them with mcap-ros2-support.
MODULES = {
    "hypothesis": ("python3-hypothesis", "hypothesis"),
    "lz4": ("mcap-ros2-support", "lz4"),
    "matplotlib": ("python3-matplotlib", "matplotlib"),
    "mcap": ("mcap-ros2-support", "mcap"),
    "mcap_ros2": ("mcap-ros2-support", "mcap-ros2-support"),
    "numba": ("python3-numba", "numba"),
    "numpy": ("python3-numpy", "numpy"),
    "pytest": ("python3-pytest", "pytest"),
    "rosbags": ("python3-rosbags-pip", "rosbags"),
    "scipy": ("python3-scipy", "scipy"),
    "sklearn": ("python3-sklearn", "scikit-learn"),
    "threadpoolctl": ("python3-sklearn", "threadpoolctl"),  # it comes with scikit-learn
    "tqdm": ("python3-tqdm", "tqdm"),
    "websockets": ("python3-websockets", "websockets"),
    "yaml": ("python3-yaml", "PyYAML"),
    "zstandard": ("mcap-ros2-support", "zstandard"),
}
# rosdistro has no key for these. What needs them says `pip install` where they are missing; the
# extra of setup.py that has them.
OPTIONAL = {
    "cyclonedds": "rigs",
    "dask": "workers",
    "distributed": "workers",
    "dpsimpy": "plants",
    "fsspec": "store",
    "jsbsim": "plants",
    "upath": "store",
}
PYPI = {
    "dpsimpy": "dpsim",
    "upath": "universal-pathlib",
}  # under another name than the module's


def sources(package):
    """Return the files of a package that run, and those that test it."""
    run = [*(SRC / package / package).rglob("*.py"), *(SRC / package / "launch").glob("*.py")]
    return run, list((SRC / package / "test").rglob("*.py"))


def imported(package, files):
    """Return the modules that files import, run by ``-m``, or load as messages by name."""
    beside = {path.stem for path in files}
    is_there = importlib.util.find_spec
    actual = set()
    for path in files:
        text = path.read_text()
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Import):
                actual |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                actual.add(node.module)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                message = re.fullmatch(r"(\w+)/(msg|srv)/\w+", node.value)
                actual |= {message[1]} if message and is_there(message[1]) else set()
            elif isinstance(node, ast.List):
                words = [getattr(item, "value", "") for item in node.elts]
                actual |= {name for flag, name in pairwise(words) if flag == "-m"}
    names = {name.split(".")[0] for name in actual}
    return names - set(sys.stdlib_module_names) - beside - {package, ""}


def manifest(package):
    """Return the root of a package.xml."""
    return ElementTree.parse(SRC / package / "package.xml").getroot()


def declared(package, *tags):
    """Return what package.xml names under some tags."""
    return {item.text for tag in tags for item in manifest(package).findall(tag)}


@pytest.fixture
def setup_of(monkeypatch):
    """Return a function that gives the arguments of a setup.py."""

    def read(package):
        options = {}
        monkeypatch.chdir(SRC / package)
        monkeypatch.setattr("setuptools.setup", lambda **arguments: options.update(arguments))
        runpy.run_path("setup.py")
        return options

    return read


@pytest.mark.parametrize("package", OURS)
def test_package_xml_names_every_import(package):
    run, test = (imported(package, files) - set(OPTIONAL) for files in sources(package))
    key_of = {name: MODULES.get(name, (name,))[0] for name in run | test}
    at_run_time = declared(package, "depend", "exec_depend")
    for_tests = at_run_time | declared(package, "test_depend")
    assert {key_of[name] for name in run} - at_run_time == set(), "add an <exec_depend>"
    assert {key_of[name] for name in test} - for_tests == set(), "add a <test_depend>"


@pytest.mark.parametrize("package", OURS)
def test_package_xml_names_nothing_that_is_not_used(package):
    run, test = sources(package)
    for files, tags in ((run, ("depend", "exec_depend")), (test, ("test_depend",))):
        text = "".join(path.read_text() for path in files)
        keys = {MODULES.get(name, (name,))[0] for name in imported(package, files)}
        # an executable of another package is started by the package's name
        assert {
            name for name in declared(package, *tags) - keys if f'"{name}"' not in text
        } == set()


@pytest.mark.parametrize("package", OURS)
def test_setup_py_names_extras_alone(package, setup_of):
    options = setup_of(package)
    extras = options.get("extras_require", {})
    run, test = (imported(package, files) for files in sources(package))
    from_pypi = {name: MODULES[name][1] for name in (run | test) & set(MODULES)}
    python = {name: name for name in (run | test) & set(OURS)} | from_pypi
    required = {python[name] for name in run & set(python)}
    assert "install_requires" not in options, "package.xml says it"
    for_tests = {python[name] for name in test & set(python)} - required
    assert set(extras.get("test", ())) - set(OPTIONAL) == for_tests, "see extras_require"
    for name in (run | test) & set(OPTIONAL):
        assert PYPI.get(name, name) in extras[OPTIONAL[name]]
        assert name not in test or PYPI.get(name, name) in extras["test"]


@pytest.mark.parametrize("package", OURS)
def test_setup_py_says_of_package_xml_what_is_installed_alone(package, setup_of):
    """The version of what is installed: a bag says which one wrote it."""
    options, root = setup_of(package), manifest(package)
    for tag in ("name", "version"):
        assert options[tag] == root.find(tag).text, tag
    assert not options.keys() & {"description", "license", "maintainer", "maintainer_email"}


def test_the_packages_have_no_circle_not_even_by_their_tests():
    """Or colcon finds no order to build them in."""
    tags = ("depend", "build_depend", "buildtool_depend", "exec_depend", "test_depend")
    below = {package: declared(package, *tags) & PACKAGES for package in PACKAGES}
    while below:
        free = {package for package, needed in below.items() if not needed & set(below)}
        assert free, below
        below = {package: needed for package, needed in below.items() if package not in free}


@pytest.mark.parametrize("package", OURS)
def test_colcon_finds_tests_in_every_package(package, setup_of):
    assert list((SRC / package / "test").glob("test_*.py"))
    assert (
        "pytest" in setup_of(package)["extras_require"]["test"]
    )  # or it runs unittest, on nothing


@pytest.mark.parametrize("package", OURS)
def test_a_package_tests_itself_with_its_own_files(package):
    """What needs the repository is in tests/: a released package is alone."""
    for path in sources(package)[1]:
        depth = len(path.relative_to(SRC / package).parts)
        ups = re.findall(r"parents\[(\d+)\]", path.read_text())
        assert all(int(up) < depth for up in ups), path
