from setuptools import find_packages, setup

PACKAGE = "relay_esc"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + PACKAGE]),
        ("share/" + PACKAGE, ["package.xml"]),
    ],
    extras_require={"test": ["hypothesis", "pytest", "scipy"]},
    entry_points={
        "console_scripts": ["esc = relay_esc.executable:main"],
        "rclpy_components": ["relay_esc::EscNode = relay_esc.node:EscNode"],
    },
)
