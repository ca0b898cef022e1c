from setuptools import find_packages, setup

PACKAGE = "koop_identify"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + PACKAGE]),
        ("share/" + PACKAGE, ["package.xml"]),
    ],
    extras_require={"test": ["hypothesis", "pytest", "rosbags", "scipy"]},
)
