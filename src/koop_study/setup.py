from setuptools import find_packages, setup

PACKAGE = "koop_study"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + PACKAGE]),
        ("share/" + PACKAGE, ["package.xml"]),
    ],
    extras_require={"test": ["koop_lab", "dask", "pytest"], "workers": ["dask", "distributed"]},
    entry_points={"koop.commands": ["study = koop_study.command:register"]},
)
