"""Every package has what a release needs of it."""

import re
from pathlib import Path

import pytest
from catkin_pkg.package import parse_package

ROOT = Path(__file__).parents[2]
PACKAGES = [parse_package(path) for path in sorted(ROOT.glob("src/*/package.xml"))]


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_a_package_names_the_license_of_the_repository(package):
    assert package.licenses == ["Apache-2.0"]
    assert "Apache License" in (ROOT / "LICENSES/Apache-2.0.txt").read_text()
    assert (ROOT / "LICENSE").samefile(ROOT / "LICENSES/Apache-2.0.txt")


def test_all_packages_have_one_version():
    """Bloom releases a repository under one version."""
    others = [*ROOT.glob("src/*/setup.py"), ROOT / "python/pyproject.toml", ROOT / "CITATION.cff"]
    versions = {package.version for package in PACKAGES}
    for path in others:
        versions.update(re.findall(r'(?m)^ *version(?: ?= ?|: )"?([^",\n]+)', path.read_text()))
    assert len(versions) == 1
