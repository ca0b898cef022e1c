from setuptools import find_packages, setup

PACKAGE = "koop_bench"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={"koop_bench": ["closed_loop.c"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + PACKAGE]),
        ("share/" + PACKAGE, ["package.xml"]),
    ],
    extras_require={"test": ["pytest"]},
    entry_points={"koop.commands": ["bench = koop_bench.command:register"]},
)
