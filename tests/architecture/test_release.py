"""Every package has what a release needs of it."""

from pathlib import Path

import pytest
from catkin_pkg.changelog import Changelog, populate_changelog_from_rst
from catkin_pkg.package import parse_package

ROOT = Path(__file__).parents[2]
PACKAGES = sorted(path.parent for path in ROOT.glob("src/*/package.xml"))


@pytest.mark.parametrize("package", PACKAGES, ids=lambda path: path.name)
def test_a_package_has_the_license_and_a_changelog(package):
    assert (package / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()
    text = (package / "CHANGELOG.rst").read_text()
    assert f"\nChangelog for package {package.name}\n" in text
    # as a release does it, and then as bloom reads it
    text = text.replace("Forthcoming\n-----------\n", "9.9.9 (2000-01-01)\n------------------\n")
    changelog = Changelog(package.name)
    populate_changelog_from_rst(changelog, text)
    for version, _, entries in changelog.foreach_version():
        assert version in ("9.9.9", parse_package(package).version)
        assert entries
    assert any(changelog.foreach_version())


def test_all_packages_have_one_version():
    """Bloom releases a repository under one version."""
    assert len({parse_package(package).version for package in PACKAGES}) == 1
