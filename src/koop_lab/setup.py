from setuptools import find_packages, setup

PACKAGE = "koop_lab"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={"koop_lab.cli": ["commands.txt"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + PACKAGE]),
        ("share/" + PACKAGE, ["package.xml"]),
    ],
    extras_require={"test": ["pytest", "PyYAML", "rosbags"]},
    entry_points={
        "console_scripts": ["koop = koop_lab.cli.main:main"],
        "koop.commands": [
            "bag = koop_lab.commands.bag:register",
            "demo = koop_lab.commands.demo:register",
            "doctor = koop_lab.commands.doctor:register",
            "inspect = koop_lab.commands.train:register",
            "params = koop_lab.commands.params:register",
            "replay = koop_lab.commands.replay:register",
            "report = koop_lab.commands.report:register",
            "simulate = koop_lab.commands.simulate:register",
            "status = koop_lab.commands.status:register",
            "train = koop_lab.commands.train:register",
            "up = koop_lab.commands.up:register",
        ],
    },
)
