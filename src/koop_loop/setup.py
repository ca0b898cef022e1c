from setuptools import find_packages, setup

PACKAGE = "koop_loop"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + PACKAGE]),
        ("share/" + PACKAGE, ["package.xml"]),
    ],
    extras_require={"test": ["pytest"]},
    maintainer="koop maintainers",
    maintainer_email="maintainers@koop.invalid",
    description="The closed loop as a pure function, its metrics and training. Needs no ROS.",
    license="Apache-2.0",
)
