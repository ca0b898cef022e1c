from setuptools import find_packages, setup

PACKAGE = "koop_view"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={"koop_view": ["page/*.html"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + PACKAGE]),
        ("share/" + PACKAGE, ["package.xml"]),
    ],
    extras_require={"test": ["hypothesis", "pytest"]},
    entry_points={
        "koop.commands": ["serve = koop_view.command:register"],
    },
)
