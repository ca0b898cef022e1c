from setuptools import find_packages, setup

PACKAGE = "koop_hil"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={"koop_hil": ["scenarios/*.yaml", "models/*.npz", "rigs/*.py", "rigs/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + PACKAGE]),
        ("share/" + PACKAGE, ["package.xml"]),
    ],
    extras_require={
        "rigs": ["cyclonedds"],
        "plants": ["jsbsim", "dpsim"],
        "test": ["pytest"],
    },
    entry_points={"koop.commands": ["hil = koop_hil.command:register"]},
)
