from setuptools import find_packages, setup

PACKAGE = "koopman_lifter"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={PACKAGE: ["models/*.npz"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + PACKAGE]),
        ("share/" + PACKAGE, ["package.xml"]),
    ],
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": ["lifter = koopman_lifter.executable:main"],
        "rclpy_components": ["koopman_lifter::LifterNode = koopman_lifter.node:LifterNode"],
    },
)
