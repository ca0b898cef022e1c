from glob import glob

from setuptools import find_packages, setup

PACKAGE = "koop_bringup"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + PACKAGE]),
        ("share/" + PACKAGE, ["package.xml"]),
        ("share/" + PACKAGE + "/launch", glob("launch/*.launch.py")),
        ("share/" + PACKAGE + "/config", glob("config/*.yaml")),
        ("share/" + PACKAGE + "/layouts", glob("layouts/*")),
        ("share/" + PACKAGE + "/security", glob("security/*.xml")),
    ],
    extras_require={"test": ["pytest"]},
    entry_points={"koop_stages": ["composed = koop_bringup.composed:find"]},
)
